//! Which faces to turn so that neighbours agree on what is outside.

use crate::mesh::Face;
use crate::topology::Topology;

/// What [`orientation`] finds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Orientation {
    /// Whether each face is to be turned (F).
    pub is_turned: Vec<bool>,
    /// Edges of two faces that both run through them in the same direction, as the mesh is.
    pub disagreeing_edges: usize,
    /// The same once `is_turned` is done; 0 unless a component is one-sided.
    pub edges_left: usize,
    /// Components that no turning makes consistent, as a Möbius strip.
    pub one_sided_components: usize,
}

/// Finds the faces to turn so that both faces of every edge run through it in opposite directions.
///
/// Components are faces that hang together by edges of exactly two faces; across all other edges nothing is asked. In
/// each the direction of the greater part stays, and of two equal parts that of the face with the lowest id. A
/// one-sided component is turned only if that leaves fewer edges that disagree. Faces that use a vertex twice stay.
///
/// ```
/// use gcnd_geom::{Topology, orientation::orientation};
/// let topology = Topology::new(vec![[0, 1, 2], [1, 2, 3], [2, 4, 3]], 5)?;
/// let found = orientation(&topology);
/// assert_eq!((found.is_turned, found.disagreeing_edges), (vec![true, false, false], 1));
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
///
/// Choice: docs/choices.md#orientation.
pub fn orientation(topology: &Topology) -> Orientation {
    let n_faces = topology.n_faces();
    let mut is_turned = vec![false; n_faces];
    let mut is_seen = vec![false; n_faces];
    let (mut disagreeing_edges, mut edges_left, mut one_sided_components) = (0, 0, 0);
    let mut component: Vec<u32> = Vec::new();
    for first in 0..n_faces {
        if is_seen[first] {
            continue;
        }
        component.clear();
        component.push(first as u32);
        is_seen[first] = true;
        // Every edge is met from both of its faces, hence twice.
        let (mut before, mut after, mut next) = (0, 0, 0);
        while let Some(&face_id) = component.get(next) {
            next += 1;
            for (other, disagrees) in links(topology, face_id) {
                let turn = is_turned[face_id as usize] != disagrees;
                if !is_seen[other as usize] {
                    is_seen[other as usize] = true;
                    is_turned[other as usize] = turn;
                    component.push(other);
                }
                before += usize::from(disagrees);
                after += usize::from(is_turned[other as usize] != turn);
            }
        }
        let is_worse = after > 0 && after >= before;
        let n_turned = component.iter().filter(|&&face_id| is_turned[face_id as usize]).count();
        if is_worse || 2 * n_turned > component.len() {
            for &face_id in &component {
                is_turned[face_id as usize] = !is_worse && !is_turned[face_id as usize];
            }
        }
        disagreeing_edges += before / 2;
        edges_left += if is_worse { before / 2 } else { after / 2 };
        one_sided_components += usize::from(after > 0);
    }
    Orientation { is_turned, disagreeing_edges, edges_left, one_sided_components }
}

/// The faces across edges of exactly two faces, and whether both run through the edge in the same direction.
fn links(topology: &Topology, face_id: u32) -> impl Iterator<Item = (u32, bool)> + '_ {
    let faces = topology.faces();
    let face = faces[face_id as usize];
    (0..3).filter(move |_| is_proper(face)).filter_map(move |corner| {
        let (a, b) = (face[corner], face[(corner + 1) % 3]);
        let neighbors = topology.edge_neighbors(face_id as usize).iter();
        let mut across = neighbors.filter(|&&other| {
            let other_face = faces[other as usize];
            is_proper(other_face) && other_face.contains(&a) && other_face.contains(&b)
        });
        let (&other, None) = (across.next()?, across.next()) else { return None };
        let other_face = faces[other as usize];
        Some((other, (0..3).any(|c| other_face[c] == a && other_face[(c + 1) % 3] == b)))
    })
}

fn is_proper([a, b, c]: Face) -> bool {
    a != b && b != c && c != a
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    fn found(faces: &[Face]) -> Orientation {
        let n_vertices = faces.iter().flatten().max().map_or(0, |&v| v as usize + 1);
        orientation(&Topology::new(faces.to_vec(), n_vertices).expect("valid"))
    }

    fn turned(mut faces: Vec<Face>, ids: &[usize]) -> Vec<Face> {
        for &id in ids {
            faces[id].swap(1, 2);
        }
        faces
    }

    #[test]
    fn what_agrees_stays() {
        for (_, faces) in
            [fixtures::cube(), fixtures::grid(4, 3), fixtures::hourglass(), fixtures::open_fan()]
        {
            let at_rest = found(&faces);
            assert_eq!(
                (at_rest.disagreeing_edges, at_rest.edges_left, at_rest.one_sided_components),
                (0, 0, 0)
            );
            assert!(at_rest.is_turned.iter().all(|&turn| !turn));
        }
    }

    #[test]
    fn exactly_the_turned_faces_are_found() {
        let (vertices, faces) = fixtures::icosphere(2);
        let ids = [0, 7, 8, 100, 127];
        let found = found(&turned(faces.clone(), &ids));
        let is_turned: Vec<usize> = (0..faces.len()).filter(|&f| found.is_turned[f]).collect();
        assert_eq!(is_turned, ids);
        assert_eq!((found.edges_left, found.one_sided_components), (0, 0));
        let brute = turned(faces, &ids);
        let pairs = crate::edge_pairs::find_edge_pairs(&Topology::new(brute, vertices.len()).expect("valid"));
        assert_eq!(found.disagreeing_edges, pairs.iter().filter(|pair| pair.is_flipped).count());
    }

    #[test]
    fn the_greater_part_stays_in_each_component() {
        // Two strips of three faces; one face of the first is turned, and two of the second.
        let strip = |v: u32| [[v, v + 1, v + 2], [v + 2, v + 1, v + 3], [v + 2, v + 3, v + 4]];
        let faces = turned([strip(0), strip(5)].concat(), &[0, 4, 5]);
        assert_eq!(found(&faces).is_turned, [true, false, false, true, false, false]);
        assert_eq!(found(&[[0, 1, 2], [1, 2, 3]]).is_turned, [false, true], "of two the first stays");
    }

    #[test]
    fn a_moebius_strip_says_so() {
        let (_, faces) = fixtures::moebius();
        let at_rest = found(&faces);
        assert_eq!((at_rest.disagreeing_edges, at_rest.edges_left, at_rest.one_sided_components), (1, 1, 1));
        assert!(at_rest.is_turned.iter().all(|&turn| !turn), "turning would leave as many");
        let worse = found(&turned(faces, &[3, 5, 8]));
        assert!(worse.disagreeing_edges > 3 && worse.edges_left == 1, "{worse:?}");
    }

    #[test]
    fn nothing_is_asked_across_three_faces_or_by_degenerate_ones() {
        let (_, faces) = fixtures::three_on_an_edge();
        assert_eq!(found(&faces).disagreeing_edges, 0);
        let degenerate = found(&[[0, 1, 2], [0, 1, 1], [1, 0, 3]]);
        assert_eq!((degenerate.disagreeing_edges, degenerate.one_sided_components), (0, 0));
    }
}
