//! Vertices across an edge, and the umbrella operator that averages them.

use crate::csr::Csr;
use crate::error::Result;
use crate::topology::Topology;
use crate::watch::{Run, Watch};
use glam::DVec3;
use rayon::prelude::*;

/// Vertices of one unit of parallel work.
pub(crate) const CHUNK: usize = 4096;

/// Vertex → the vertices that share an edge of a face with it, ascending, each once, without itself.
pub(crate) fn adjacent_vertices(topology: &Topology) -> Csr {
    let n_vertices = topology.n_vertices();
    let chunks: Vec<(Vec<u32>, Vec<u32>)> = (0..n_vertices.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let (mut lengths, mut values, mut row) = (Vec::new(), Vec::new(), Vec::new());
            for vertex_id in chunk * CHUNK..n_vertices.min((chunk + 1) * CHUNK) {
                row.clear();
                for &face_id in topology.vertex_faces().row(vertex_id) {
                    let face = topology.faces()[face_id as usize];
                    row.extend(face.into_iter().filter(|&v| v as usize != vertex_id));
                }
                row.sort_unstable();
                row.dedup();
                lengths.push(row.len() as u32);
                values.extend_from_slice(&row);
            }
            (lengths, values)
        })
        .collect();
    let lengths: Vec<u32> = chunks.iter().flat_map(|(lengths, _)| lengths.iter().copied()).collect();
    Csr::from_lengths(&lengths, chunks.into_iter().flat_map(|(_, values)| values).collect())
}

/// Moves every vertex towards the mean of its neighbours by each of `factors` in turn, `iterations` times; a negative
/// factor moves it away.
pub(crate) fn smooth(
    topology: &Topology,
    vertices: &[DVec3],
    factors: &[f64],
    iterations: usize,
    fix_boundary: bool,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    let (mut run, mut current) = Run::start(topology, vertices, iterations, watch)?;
    let umbrella = Umbrella::new(topology, fix_boundary);
    let mut next = current.clone();
    for _ in 0..iterations {
        for &factor in factors {
            umbrella.step(&current, factor, &mut next);
            std::mem::swap(&mut current, &mut next);
        }
        run.tick_positions(&current)?;
    }
    Ok(run.finish(current))
}

/// The umbrella operator on a mesh.
pub(crate) struct Umbrella {
    adjacent: Csr,
    /// Vertices that stay; empty for none.
    is_fixed: Vec<bool>,
}

impl Umbrella {
    /// Of all vertices; `fix_boundary` holds those on a boundary.
    pub fn new(topology: &Topology, fix_boundary: bool) -> Self {
        let is_fixed = if fix_boundary { topology.boundary_vertices() } else { Vec::new() };
        Self { adjacent: adjacent_vertices(topology), is_fixed }
    }

    /// Whether a vertex stays: held, or without neighbours.
    pub fn stays(&self, vertex_id: usize) -> bool {
        self.is_fixed.get(vertex_id) == Some(&true) || self.adjacent.row(vertex_id).is_empty()
    }

    /// The mean over a vertex's neighbours, which it must have.
    pub fn mean(&self, values: &[DVec3], vertex_id: usize) -> DVec3 {
        let row = self.adjacent.row(vertex_id);
        row.iter().map(|&v| values[v as usize]).sum::<DVec3>() / row.len() as f64
    }

    /// `next` ← v_i + factor · (mean of neighbours − v_i).
    pub fn step(&self, current: &[DVec3], factor: f64, next: &mut [DVec3]) {
        next.par_iter_mut().zip(current).enumerate().with_min_len(CHUNK).for_each(|(i, (moved, &v))| {
            *moved = if self.stays(i) { v } else { v + factor * (self.mean(current, i) - v) };
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    #[test]
    fn adjacent_vertices_of_tiny_meshes() {
        let rows = |(vertices, faces): fixtures::MeshParts| {
            adjacent_vertices(&Topology::new(faces, vertices.len()).expect("valid"))
        };
        assert_eq!(rows(fixtures::tetrahedron()).row(2), [0, 1, 3]);
        assert_eq!(rows(fixtures::open_fan()).row(0), [1, 2, 3, 4, 5]);
        assert_eq!(rows(fixtures::hourglass()).row(0), [1, 2, 3, 4]);
        let degenerate = Topology::new(vec![[0, 0, 1], [2, 2, 2]], 4).expect("valid");
        let rows = adjacent_vertices(&degenerate);
        assert_eq!((rows.row(0), rows.row(1)), (&[1][..], &[0][..]));
        assert!(rows.row(2).is_empty() && rows.row(3).is_empty());
    }
}
