//! Tiny meshes with known properties, for tests and benches.

use crate::mesh::Face;
use glam::DVec3;
use std::collections::HashMap;

/// Vertices and faces of a fixture.
pub type MeshParts = (Vec<DVec3>, Vec<Face>);

/// Two triangles that share the edge 1–2, folded by 90 degrees.
pub fn two_triangles() -> MeshParts {
    (vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(1.0, 1.0, 1.0)], vec![[0, 1, 2], [2, 1, 3]])
}

/// A tetrahedron, oriented outwards.
pub fn tetrahedron() -> MeshParts {
    (vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z], vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
}

/// The unit cube, two triangles a side, oriented outwards.
pub fn cube() -> MeshParts {
    let vertices =
        (0..8).map(|i| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2))).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    (vertices, quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect())
}

/// Four faces around vertex 0 that do not close.
pub fn open_fan() -> MeshParts {
    let rim = (0..5).map(|i| {
        let angle = f64::from(i) * 0.9;
        DVec3::new(angle.cos(), angle.sin(), 0.0)
    });
    (std::iter::once(DVec3::ZERO).chain(rim).collect(), (1..5).map(|i| [0, i, i + 1]).collect())
}

/// A Möbius strip of 12 faces: every face has two neighbours and no consistent orientation exists.
pub fn moebius() -> MeshParts {
    let n = 6u32;
    let mut vertices = Vec::new();
    for i in 0..n {
        let angle = f64::from(i) / f64::from(n) * std::f64::consts::TAU;
        for side in [-0.3, 0.3] {
            let r = 1.0 + side * (angle / 2.0).cos();
            vertices.push(DVec3::new(r * angle.cos(), r * angle.sin(), side * (angle / 2.0).sin()));
        }
    }
    let mut faces = Vec::new();
    for i in 0..n {
        let (a, b) = (2 * i, 2 * i + 1);
        let (c, d) = if i + 1 < n { (2 * i + 2, 2 * i + 3) } else { (1, 0) };
        faces.extend([[a, c, b], [b, c, d]]);
    }
    (vertices, faces)
}

/// Three faces that share the edge 0–1.
pub fn three_on_an_edge() -> MeshParts {
    (vec![DVec3::ZERO, DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z], vec![[0, 1, 2], [1, 0, 3], [0, 1, 4]])
}

/// Two faces that touch in a single vertex.
pub fn hourglass() -> MeshParts {
    let v = |x: f64, y: f64| DVec3::new(x, y, 0.0);
    (vec![v(0., 0.), v(1., 0.5), v(1., -0.5), v(-1., 0.5), v(-1., -0.5)], vec![[0, 2, 1], [0, 3, 4]])
}

/// Each face into four, at its edge midpoints.
pub fn split((vertices, faces): &MeshParts) -> MeshParts {
    let mut vertices = vertices.clone();
    let mut midpoints = HashMap::new();
    let mut midpoint = |a: u32, b: u32| {
        *midpoints.entry((a.min(b), a.max(b))).or_insert_with(|| {
            vertices.push((vertices[a as usize] + vertices[b as usize]) / 2.0);
            vertices.len() as u32 - 1
        })
    };
    let faces = faces
        .iter()
        .flat_map(|&[a, b, c]| {
            let [ab, bc, ca] = [midpoint(a, b), midpoint(b, c), midpoint(c, a)];
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        })
        .collect();
    (vertices, faces)
}

/// A flat grid of `nx` × `ny` unit squares in the plane z = 0, two triangles each, facing +z.
pub fn grid(nx: u32, ny: u32) -> MeshParts {
    let vertices =
        (0..=ny).flat_map(|y| (0..=nx).map(move |x| DVec3::new(x.into(), y.into(), 0.0))).collect();
    let id = |x: u32, y: u32| y * (nx + 1) + x;
    let faces = (0..ny)
        .flat_map(|y| (0..nx).map(move |x| (x, y)))
        .flat_map(|(x, y)| {
            let (a, b, c, d) = (id(x, y), id(x + 1, y), id(x + 1, y + 1), id(x, y + 1));
            [[a, b, c], [a, c, d]]
        })
        .collect();
    (vertices, faces)
}

/// The unit sphere as an octahedron split `level` times: 8·4^level faces.
pub fn icosphere(level: u32) -> MeshParts {
    let mut vertices = vec![DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z];
    let mut faces: Vec<Face> =
        vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    for _ in 0..level {
        let mut midpoints: HashMap<(u32, u32), u32> = HashMap::new();
        let mut next = Vec::with_capacity(faces.len() * 4);
        for [a, b, c] in faces {
            let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(p, q)| {
                *midpoints.entry((p.min(q), p.max(q))).or_insert_with(|| {
                    vertices.push((vertices[p as usize] + vertices[q as usize]).normalize());
                    vertices.len() as u32 - 1
                })
            });
            next.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        faces = next;
    }
    (vertices, faces)
}

/// Moves every vertex by a reproducible pseudo-random vector of at most `amplitude` in each coordinate.
pub fn jitter(vertices: &mut [DVec3], amplitude: f64, seed: u64) {
    let mut state = seed;
    let mut next = || {
        // splitmix64
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    for v in vertices {
        *v += amplitude * DVec3::new(next(), next(), next());
    }
}
