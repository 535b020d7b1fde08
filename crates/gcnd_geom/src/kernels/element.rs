//! The two number formats of the kernels: `f32` and bfloat16.

use bytemuck::{Pod, Zeroable};

/// A bfloat16 number: the upper 16 bits of an `f32`, in the memory layout of `torch.bfloat16`.
///
/// ```
/// use gcnd_geom::kernels::Bf16;
/// assert_eq!(Bf16::from_f32(1.5).to_f32(), 1.5);
/// assert_eq!(Bf16::from_f32(1.0 + 1.0 / 512.0).to_f32(), 1.0);
/// ```
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(transparent)]
pub struct Bf16(u16);

impl Bf16 {
    /// Reads the number from its 16 bits.
    pub const fn from_bits(bits: u16) -> Self {
        Self(bits)
    }

    /// Returns the number's 16 bits.
    pub const fn to_bits(self) -> u16 {
        self.0
    }

    /// Rounds to the nearest bfloat16, ties to even; a NaN stays a NaN.
    #[inline(always)]
    pub fn from_f32(value: f32) -> Self {
        let bits = value.to_bits();
        let rounded = bits.wrapping_add(0x7fff + ((bits >> 16) & 1)) >> 16;
        // Rounding could carry a NaN's payload over into infinity.
        let quiet_nan = (bits >> 16) | 0x0040;
        Self(if value.is_nan() { quiet_nan } else { rounded } as u16)
    }

    /// Widens to `f32`, exactly.
    #[inline(always)]
    pub fn to_f32(self) -> f32 {
        f32::from_bits(u32::from(self.0) << 16)
    }
}

impl PartialEq for Bf16 {
    fn eq(&self, other: &Self) -> bool {
        self.to_f32() == other.to_f32()
    }
}

/// A number format that the kernels read and write: `f32` or [`Bf16`]. Sealed.
///
/// The maximum is taken over keys, which order as the values do and are as wide as them, so that a vector
/// register holds as many keys as values.
pub trait Element: Pod + Send + Sync + sealed::Sealed {
    /// An order-preserving image of the value.
    #[doc(hidden)]
    type Key: Copy + PartialOrd;
    /// A node id as wide as the key.
    #[doc(hidden)]
    type Id: Copy;
    #[doc(hidden)]
    fn key(self) -> Self::Key;
    #[doc(hidden)]
    fn from_key(key: Self::Key) -> Self;
    #[doc(hidden)]
    fn id(node_id: u16) -> Self::Id;
    #[doc(hidden)]
    fn node_id(id: Self::Id) -> u16;
    /// Widens to `f32`, exactly.
    fn to_f32(self) -> f32;
    /// Rounds to the nearest number of the format, ties to even.
    fn from_f32(value: f32) -> Self;
}

impl Element for f32 {
    type Key = f32;
    type Id = u32;

    #[inline(always)]
    fn key(self) -> f32 {
        self
    }

    #[inline(always)]
    fn from_key(key: f32) -> f32 {
        key
    }

    #[inline(always)]
    fn id(node_id: u16) -> u32 {
        u32::from(node_id)
    }

    #[inline(always)]
    fn node_id(id: u32) -> u16 {
        id as u16
    }

    #[inline(always)]
    fn to_f32(self) -> f32 {
        self
    }

    #[inline(always)]
    fn from_f32(value: f32) -> f32 {
        value
    }
}

impl Element for Bf16 {
    type Key = i16;
    type Id = u16;

    /// Sign and magnitude to two's complement: the integers then order as the numbers do, and −0 equals +0.
    #[inline(always)]
    fn key(self) -> i16 {
        let bits = self.0 as i16;
        let sign = bits >> 15;
        ((bits & 0x7fff) ^ sign).wrapping_sub(sign)
    }

    #[inline(always)]
    fn from_key(key: i16) -> Self {
        let sign = key >> 15;
        Self(((key ^ sign).wrapping_sub(sign) as u16) | (sign as u16 & 0x8000))
    }

    #[inline(always)]
    fn id(node_id: u16) -> u16 {
        node_id
    }

    #[inline(always)]
    fn node_id(id: u16) -> u16 {
        id
    }

    #[inline(always)]
    fn to_f32(self) -> f32 {
        self.to_f32()
    }

    #[inline(always)]
    fn from_f32(value: f32) -> Self {
        Self::from_f32(value)
    }
}

mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for super::Bf16 {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_to_nearest_even() {
        let bits = |value: f32| Bf16::from_f32(value).to_bits();
        assert_eq!(bits(1.0), 0x3f80);
        // Halfway between 0x3f80 and 0x3f81, then between 0x3f81 and 0x3f82: to the even one each time.
        assert_eq!(bits(f32::from_bits(0x3f80_8000)), 0x3f80);
        assert_eq!(bits(f32::from_bits(0x3f81_8000)), 0x3f82);
        assert_eq!(bits(f32::from_bits(0x3f80_8001)), 0x3f81);
        assert_eq!(bits(f32::MAX), 0x7f80);
        assert_eq!(bits(f32::NEG_INFINITY), 0xff80);
        assert!(Bf16::from_f32(f32::from_bits(0x7fff_ffff)).to_f32().is_nan());
        assert!(Bf16::from_f32(f32::from_bits(0x7f80_0001)).to_f32().is_nan());
    }

    #[test]
    fn keys_order_all_numbers_and_map_back() {
        let numbers = |bits: u16| Some(Bf16::from_bits(bits)).filter(|x| !x.to_f32().is_nan());
        let mut all: Vec<Bf16> = (0..=u16::MAX).filter_map(numbers).collect();
        all.sort_by(|x, y| x.to_f32().total_cmp(&y.to_f32()));
        for pair in all.windows(2) {
            let expected = pair[0].to_f32().partial_cmp(&pair[1].to_f32());
            assert_eq!(pair[0].key().partial_cmp(&pair[1].key()), expected, "{pair:?}");
        }
        for x in all {
            assert_eq!(Bf16::from_key(x.key()), x);
        }
    }
}
