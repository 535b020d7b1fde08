//! A small map from ids to slots that is emptied in constant time: a patch touches a few hundred of a mesh's
//! faces, so its memory should be the size of the patch, not of the mesh.

/// Ids with a slot each, by open addressing; an entry counts only while it carries the current stamp.
#[derive(Debug, Clone)]
pub(crate) struct IdSlots {
    /// `stamp << 32 | id`, zero when never used.
    keys: Vec<u64>,
    slots: Vec<u32>,
    stamp: u32,
    len: usize,
}

/// The slot of an id that was inserted but given none.
pub(crate) const NO_SLOT: u32 = u32::MAX;

impl IdSlots {
    /// An empty map.
    pub(crate) fn new() -> Self {
        const INITIAL: usize = 512;
        Self { keys: vec![0; INITIAL], slots: vec![NO_SLOT; INITIAL], stamp: 1, len: 0 }
    }

    /// Forgets every id.
    pub(crate) fn clear(&mut self) {
        self.len = 0;
        self.stamp = self.stamp.wrapping_add(1);
        if self.stamp == 0 {
            self.keys.fill(0);
            self.stamp = 1;
        }
    }

    /// Adds an id without a slot; says whether it was new.
    #[inline]
    pub(crate) fn insert(&mut self, id: u32) -> bool {
        let position = self.position(id);
        if self.keys[position] == self.key(id) {
            return false;
        }
        self.keys[position] = self.key(id);
        self.slots[position] = NO_SLOT;
        self.len += 1;
        if self.len * 2 > self.keys.len() {
            self.grow();
        }
        true
    }

    /// Gives a slot to an id that [`IdSlots::insert`] has added; does nothing for any other id.
    #[inline]
    pub(crate) fn set_slot(&mut self, id: u32, slot: u32) {
        let position = self.position(id);
        if self.keys[position] == self.key(id) {
            self.slots[position] = slot;
        }
    }

    /// The slot of an id, [`NO_SLOT`] when it is absent or has none.
    #[inline]
    pub(crate) fn slot(&self, id: u32) -> u32 {
        let position = self.position(id);
        if self.keys[position] == self.key(id) { self.slots[position] } else { NO_SLOT }
    }

    #[inline]
    fn key(&self, id: u32) -> u64 {
        u64::from(self.stamp) << 32 | u64::from(id)
    }

    /// Where the id is, or the free place where it would go.
    #[inline]
    fn position(&self, id: u32) -> usize {
        let wrap = self.keys.len() - 1;
        let hash = u64::from(id).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 32;
        let mut position = hash as usize & wrap;
        loop {
            let key = self.keys[position];
            if (key >> 32) as u32 != self.stamp || key as u32 == id {
                return position;
            }
            position = (position + 1) & wrap;
        }
    }

    #[cold]
    fn grow(&mut self) {
        let doubled = self.keys.len() * 2;
        let old_keys = std::mem::replace(&mut self.keys, vec![0; doubled]);
        let old_slots = std::mem::replace(&mut self.slots, vec![NO_SLOT; doubled]);
        for (key, slot) in old_keys.into_iter().zip(old_slots) {
            if (key >> 32) as u32 == self.stamp {
                let position = self.position(key as u32);
                self.keys[position] = key;
                self.slots[position] = slot;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slots_survive_growth_and_vanish_on_clear() {
        let mut map = IdSlots::new();
        for round in 0..3u32 {
            map.clear();
            for id in 0..5000u32 {
                assert!(map.insert(id * 7 + round));
                assert!(!map.insert(id * 7 + round));
                map.set_slot(id * 7 + round, id);
            }
            assert!((0..5000).all(|id| map.slot(id * 7 + round) == id));
            assert_eq!(map.slot(6 + round), NO_SLOT);
        }
        map.clear();
        assert_eq!(map.slot(2), NO_SLOT);
        map.set_slot(2, 9);
        assert_eq!(map.slot(2), NO_SLOT, "only inserted ids take a slot");
    }

    #[test]
    fn a_stamp_that_wraps_around_forgets_too() {
        let mut map = IdSlots::new();
        map.insert(3);
        map.stamp = u32::MAX;
        map.insert(4);
        map.clear();
        assert!(map.insert(3) && map.insert(4) && map.insert(0));
    }
}
