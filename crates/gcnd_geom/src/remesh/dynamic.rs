//! A triangle mesh that changes: faces around each vertex, and the three local operations on them.

use glam::DVec3;

use crate::mesh::Face;

/// A dead face: all three ids are `u32::MAX`.
const DEAD: Face = [u32::MAX; 3];

/// The chain id of an edge that may not be changed at all.
pub(super) const LOCKED: u32 = u32::MAX;

/// One end of a feature edge, stored at its other end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Link {
    /// The vertex at the far end.
    pub to: u32,
    /// The feature curve that the edge belongs to, or [`LOCKED`].
    pub chain: u32,
}

/// Faces, the faces around each vertex, and the feature edges at each vertex.
///
/// Ids stay valid while the mesh changes: a removed face is dead, a removed vertex has no faces.
#[derive(Debug, Clone, Default)]
pub(super) struct DynamicMesh {
    pub positions: Vec<DVec3>,
    /// The wanted edge length at each vertex.
    pub sizes: Vec<f64>,
    pub faces: Vec<Face>,
    /// The smooth region, bounded by feature edges, that each face lies in.
    pub regions: Vec<u32>,
    pub vertex_faces: Vec<Vec<u32>>,
    pub links: Vec<Vec<Link>>,
    /// Corners and locked vertices: they neither move nor vanish.
    pub fixed: Vec<bool>,
}

impl DynamicMesh {
    /// Takes the faces that name three different vertices.
    pub fn new(positions: Vec<DVec3>, sizes: Vec<f64>, faces: &[Face]) -> Self {
        let n_vertices = positions.len();
        let faces: Vec<Face> =
            faces.iter().copied().filter(|f| f[0] != f[1] && f[1] != f[2] && f[2] != f[0]).collect();
        let mut vertex_faces = vec![Vec::new(); n_vertices];
        for (face_id, face) in faces.iter().enumerate() {
            for &v in face {
                vertex_faces[v as usize].push(face_id as u32);
            }
        }
        Self {
            positions,
            sizes,
            regions: vec![0; faces.len()],
            faces,
            vertex_faces,
            links: vec![Vec::new(); n_vertices],
            fixed: vec![false; n_vertices],
        }
    }

    pub fn position(&self, vertex_id: u32) -> DVec3 {
        self.positions[vertex_id as usize]
    }

    pub fn edge_length(&self, a: u32, b: u32) -> f64 {
        self.position(a).distance(self.position(b))
    }

    /// The wanted length of the edge between two vertices.
    pub fn wanted_length(&self, a: u32, b: u32) -> f64 {
        0.5 * (self.sizes[a as usize] + self.sizes[b as usize])
    }

    /// The feature edge between two vertices, if there is one.
    pub fn link(&self, a: u32, b: u32) -> Option<Link> {
        self.links[a as usize].iter().copied().find(|link| link.to == b)
    }

    /// Neither on a feature curve nor fixed.
    pub fn is_smooth(&self, v: u32) -> bool {
        self.links[v as usize].is_empty() && !self.fixed[v as usize]
    }

    /// The face's normal times twice its area.
    pub fn cross(&self, face_id: u32) -> DVec3 {
        let [a, b, c] = self.faces[face_id as usize].map(|v| self.position(v));
        (b - a).cross(c - a)
    }

    /// The first two faces that hold both vertices, and how many there are.
    pub fn edge_faces(&self, a: u32, b: u32) -> ([u32; 2], usize) {
        let mut found = [0; 2];
        let mut count = 0;
        for &face_id in &self.vertex_faces[a as usize] {
            if self.faces[face_id as usize].contains(&b) {
                if count < 2 {
                    found[count] = face_id;
                }
                count += 1;
            }
        }
        (found, count)
    }

    /// The vertex of a face that is neither `a` nor `b`.
    pub fn opposite(&self, face_id: u32, a: u32, b: u32) -> u32 {
        let face = self.faces[face_id as usize];
        face.into_iter().find(|&v| v != a && v != b).unwrap_or(a)
    }

    /// Writes the vertices that share an edge with `v` to `out`, each once.
    pub fn neighbors(&self, v: u32, out: &mut Vec<u32>) {
        out.clear();
        for &face_id in &self.vertex_faces[v as usize] {
            for other in self.faces[face_id as usize] {
                if other != v && !out.contains(&other) {
                    out.push(other);
                }
            }
        }
    }

    /// Whether a face holds both vertices.
    pub fn is_edge(&self, a: u32, b: u32) -> bool {
        self.vertex_faces[a as usize].iter().any(|&f| self.faces[f as usize].contains(&b))
    }

    /// All edges `(smaller id, larger id)`, each once, in ascending order.
    pub fn edges(&self) -> Vec<(u32, u32)> {
        let mut edges = Vec::with_capacity(self.faces.len() * 3);
        for face in self.faces.iter().filter(|face| **face != DEAD) {
            for i in 0..3 {
                let (a, b) = (face[i], face[(i + 1) % 3]);
                edges.push((a.min(b), a.max(b)));
            }
        }
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// Puts a new vertex at `position` on the edge `a`–`b`, whose faces become two each.
    pub fn split_edge(&mut self, a: u32, b: u32, position: DVec3) -> u32 {
        let m = self.positions.len() as u32;
        let (edge_faces, count) = self.edge_faces(a, b);
        self.positions.push(position);
        self.sizes.push(self.wanted_length(a, b));
        self.fixed.push(false);
        self.links.push(Vec::new());
        self.vertex_faces.push(Vec::with_capacity(8));
        for &f in &edge_faces[..count.min(2)] {
            let g = self.faces.len() as u32;
            let old = self.faces[f as usize];
            let c = self.opposite(f, a, b);
            self.faces[f as usize] = old.map(|v| if v == b { m } else { v });
            self.faces.push(old.map(|v| if v == a { m } else { v }));
            self.regions.push(self.regions[f as usize]);
            for slot in &mut self.vertex_faces[b as usize] {
                if *slot == f {
                    *slot = g;
                }
            }
            self.vertex_faces[c as usize].push(g);
            self.vertex_faces[m as usize].extend([f, g]);
        }
        if let Some(link) = self.link(a, b) {
            self.replace_link(a, b, m);
            self.replace_link(b, a, m);
            self.links[m as usize].extend([Link { to: a, ..link }, Link { to: b, ..link }]);
        }
        m
    }

    /// Merges `removed` into `kept`; the faces on their edge die. The caller has checked the link condition.
    pub fn collapse_edge(&mut self, removed: u32, kept: u32) {
        for face_id in std::mem::take(&mut self.vertex_faces[removed as usize]) {
            let face = self.faces[face_id as usize];
            if face.contains(&kept) {
                for v in face.into_iter().filter(|&v| v != removed) {
                    self.vertex_faces[v as usize].retain(|&f| f != face_id);
                }
                self.faces[face_id as usize] = DEAD;
            } else {
                self.faces[face_id as usize] = face.map(|v| if v == removed { kept } else { v });
                self.vertex_faces[kept as usize].push(face_id);
            }
        }
        for link in std::mem::take(&mut self.links[removed as usize]) {
            if link.to == kept {
                self.links[kept as usize].retain(|l| l.to != removed);
            } else {
                self.replace_link(link.to, removed, kept);
                self.links[kept as usize].push(link);
            }
        }
    }

    /// Turns the edge `a`–`b` of faces `f` = (a, b, c) and `g` = (b, a, d) into `c`–`d`.
    pub fn flip_edge(&mut self, [a, b]: [u32; 2], [c, d]: [u32; 2], [f, g]: [u32; 2]) {
        self.faces[f as usize] = [a, d, c];
        self.faces[g as usize] = [d, b, c];
        self.vertex_faces[a as usize].retain(|&face_id| face_id != g);
        self.vertex_faces[b as usize].retain(|&face_id| face_id != f);
        self.vertex_faces[c as usize].push(g);
        self.vertex_faces[d as usize].push(f);
    }

    /// The living faces and the vertices they use, renumbered in order.
    pub fn compact(&self) -> (Vec<DVec3>, Vec<Face>) {
        let mut new_id = vec![u32::MAX; self.positions.len()];
        let mut positions = Vec::new();
        for (v, faces) in self.vertex_faces.iter().enumerate() {
            if !faces.is_empty() {
                new_id[v] = positions.len() as u32;
                positions.push(self.positions[v]);
            }
        }
        let alive = self.faces.iter().filter(|face| **face != DEAD);
        let faces = alive.map(|face| face.map(|v| new_id[v as usize])).collect();
        (positions, faces)
    }

    fn replace_link(&mut self, at: u32, from: u32, to: u32) {
        for link in &mut self.links[at as usize] {
            if link.to == from {
                link.to = to;
            }
        }
    }
}

/// Twice a triangle's area over the sum of its squared edges, scaled so that an equilateral triangle has 1.
pub(super) fn quality(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let squares = a.distance_squared(b) + b.distance_squared(c) + c.distance_squared(a);
    if squares > 0.0 { 2.0 * 3f64.sqrt() * (b - a).cross(c - a).length() / squares } else { 0.0 }
}
