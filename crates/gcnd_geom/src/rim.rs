//! Vertices on a boundary, which may move otherwise than the others.

use crate::topology::Topology;
use glam::DVec3;

/// How vertices on a boundary move, those of an edge that one face alone uses.
///
/// With d_i the step that Eq. 6 gives vertex i, m_i = Σ_{f ∈ F_i} n_f, t_i the sum of the boundary's edges at i as
/// vectors along the boundary, and c_i = normalize(t_i × m_i), which lies in the surface and points across its rim:
///
/// Choice: docs/choices.md#boundary-vertices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Boundary {
    /// Like the others: by d_i.
    #[default]
    Free,
    /// Along the normal and along the rim, never across it: by d_i − (d_i · c_i) c_i. The outline stays.
    Along,
    /// Not at all.
    Fixed,
}

impl Boundary {
    /// What the filters' switch says: held, or free.
    pub(crate) fn held_if(is_fixed: bool) -> Self {
        if is_fixed { Self::Fixed } else { Self::Free }
    }
}

/// The vertices on a boundary and how they move; empty where they move like the others.
pub(crate) struct Rim {
    boundary: Boundary,
    is_rim: Vec<bool>,
    edges: Vec<[u32; 2]>,
    /// t of each vertex (V), for the positions that [`Rim::place`] was given.
    tangents: Vec<DVec3>,
}

impl Rim {
    pub fn new(topology: &Topology, boundary: Boundary) -> Self {
        let mut rim = Self { boundary, is_rim: Vec::new(), edges: Vec::new(), tangents: Vec::new() };
        match boundary {
            Boundary::Free => {}
            Boundary::Along => {
                rim.edges = topology.boundary_edges().collect();
                rim.tangents = vec![DVec3::ZERO; topology.n_vertices()];
            }
            Boundary::Fixed => rim.is_rim = topology.boundary_vertices(),
        }
        rim
    }

    /// Takes the positions (V) that steps are measured from.
    pub fn place(&mut self, vertices: &[DVec3]) {
        for &[start, end] in &self.edges {
            self.tangents[start as usize] = DVec3::ZERO;
            self.tangents[end as usize] = DVec3::ZERO;
        }
        for &[start, end] in &self.edges {
            let way = vertices[end as usize] - vertices[start as usize];
            self.tangents[start as usize] += way;
            self.tangents[end as usize] += way;
        }
    }

    /// What is left of a vertex's step; `normal` is m, asked for only where it counts.
    #[inline]
    pub fn held(&self, vertex_id: usize, step: DVec3, normal: impl FnOnce() -> DVec3) -> DVec3 {
        match self.boundary {
            Boundary::Free => step,
            Boundary::Fixed => {
                if self.is_rim[vertex_id] {
                    DVec3::ZERO
                } else {
                    step
                }
            }
            Boundary::Along => {
                let tangent = self.tangents[vertex_id];
                if tangent == DVec3::ZERO {
                    return step;
                }
                let across = tangent.cross(normal()).normalize_or_zero();
                step - across * across.dot(step)
            }
        }
    }
}
