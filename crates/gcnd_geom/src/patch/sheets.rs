//! One sheet of a thin wall: Eq. 1 goes by distance alone, so its ball holds the wall's other side too.

use super::id_slots::NO_SLOT;
use super::select::{PatchScale, SelectScratch};
use crate::face_geometry::FaceGeometry;
use crate::normals::kernel::unit_or_zero;
use crate::topology::Topology;
use glam::DVec3;

/// Normals are opposed when their cosine is below this: more than 120° apart.
const OPPOSED_COSINE: f64 = -0.5;

/// A part whose normals cancel to less than this share of its area, as those of a closed one do, faces nowhere.
const LEAST_FACING: f64 = 0.1;

/// The slot of a face that no part has reached.
const UNREACHED: u32 = NO_SLOT - 1;

fn are_opposed(a: DVec3, b: DVec3) -> bool {
    a.dot(b) < OPPOSED_COSINE * (a.length() * b.length())
}

/// Faces that hang together, in units of the patch's mean area.
#[derive(Default)]
struct Part {
    area: f64,
    area_normal: DVec3,
}

impl Part {
    fn is_opposed_to(&self, normal: DVec3) -> bool {
        self.area_normal.length() > LEAST_FACING * self.area && are_opposed(self.area_normal, normal)
    }
}

/// Leaves out of `scratch.candidates` the parts that do not hang together with the centre inside the patch, face
/// beside face with a shared vertex, and whose area-weighted normal is opposed to that of `center`.
///
/// A patch without any opposed face is not looked at further. The order of the others stays.
///
/// Choice: docs/choices.md#other-sheets.
pub(crate) fn leave_other_sheets(
    topology: &Topology,
    geometry: &FaceGeometry,
    center: &PatchScale,
    scratch: &mut SelectScratch,
) {
    let SelectScratch { seen_faces, candidates, frontier, is_other_sheet, .. } = scratch;
    let normal_of = |face_id: u32| geometry.normals[face_id as usize];
    let center_normal = unit_or_zero(center.area_normal);
    if !candidates.iter().any(|candidate| are_opposed(normal_of(candidate.face_id), center_normal)) {
        return;
    }
    for candidate in candidates.iter() {
        seen_faces.set_slot(candidate.face_id, UNREACHED);
    }
    is_other_sheet.clear();
    for candidate in candidates.iter() {
        if seen_faces.slot(candidate.face_id) != UNREACHED {
            continue;
        }
        let part_id = is_other_sheet.len() as u32;
        let mut part = Part::default();
        seen_faces.set_slot(candidate.face_id, part_id);
        frontier.push(candidate.face_id);
        while let Some(face_id) = frontier.pop() {
            let area = geometry.areas[face_id as usize] / center.mean_area;
            part.area += area;
            part.area_normal += area * normal_of(face_id);
            for vertex_id in topology.faces()[face_id as usize] {
                for &near_face in topology.vertex_faces().row(vertex_id as usize) {
                    if seen_faces.slot(near_face) == UNREACHED {
                        seen_faces.set_slot(near_face, part_id);
                        frontier.push(near_face);
                    }
                }
            }
        }
        // The first part is the centre's.
        is_other_sheet.push(part_id > 0 && part.is_opposed_to(center_normal));
    }
    candidates.retain(|candidate| {
        let part_id = seen_faces.slot(candidate.face_id);
        seen_faces.set_slot(candidate.face_id, NO_SLOT);
        !is_other_sheet[part_id as usize]
    });
}

#[cfg(test)]
mod tests {
    use crate::fixtures;
    use crate::patch::Sheets::{self, All, One};
    use crate::patch::{PatchExtractor, PatchParams};
    use crate::{DVec3, Face, Topology};
    use glam::DQuat;

    fn selected((vertices, faces): &fixtures::MeshParts, face_id: u32, sheets: Sheets) -> Vec<u32> {
        let topology = Topology::new(faces.clone(), vertices.len()).expect("valid");
        let params = PatchParams { sheets, ..PatchParams::default() };
        let extractor = PatchExtractor::new(&topology, vertices, params).expect("valid");
        extractor.select(face_id).expect("a face").0
    }

    /// A grid and a second one above it, which faces the same way or is turned over.
    fn two_grids(side: u32, gap: f64, is_turned: bool) -> fixtures::MeshParts {
        let (mut vertices, mut faces) = fixtures::grid(side, side);
        let n = vertices.len() as u32;
        let above: Vec<DVec3> = vertices.iter().map(|&v| v + gap * DVec3::Z).collect();
        vertices.extend(above);
        let turn = |[a, b, c]: Face| if is_turned { [a, c, b] } else { [a, b, c] };
        let other: Vec<Face> = faces.iter().map(|face| turn(face.map(|v| v + n))).collect();
        faces.extend(other);
        (vertices, faces)
    }

    #[test]
    fn the_back_of_a_wall_is_left_out_and_a_layer_above_is_not() {
        let alone = selected(&fixtures::grid(12, 12), 130, One);
        for gap in [0.0, 0.01, 0.5, 2.0] {
            let wall = two_grids(12, gap, true);
            assert_eq!(selected(&wall, 130, One), alone, "gap {gap}");
            assert!(selected(&wall, 130, All).len() > alone.len() + 20);
            let layers = two_grids(12, gap, false);
            assert_eq!(selected(&layers, 130, One), selected(&layers, 130, All));
        }
    }

    #[test]
    fn a_wall_of_any_size_has_two_sides() {
        let alone = selected(&fixtures::grid(12, 12), 130, One);
        for power in [-430, -300, -200, 200, 300, 430] {
            let (mut vertices, faces) = two_grids(12, 0.5, true);
            vertices.iter_mut().for_each(|v| *v *= 2f64.powi(power));
            assert_eq!(selected(&(vertices, faces), 130, One), alone, "2^{power}");
        }
    }

    #[test]
    fn a_closed_piece_above_a_sheet_faces_nowhere_and_stays() {
        let (ball_vertices, ball_faces) = fixtures::icosphere(0);
        for turn in 0..40 {
            let (mut vertices, mut faces) = fixtures::grid(12, 12);
            let n = vertices.len() as u32;
            let middle = vertices[faces[130][0] as usize] + 0.8 * DVec3::Z;
            let rotation = DQuat::from_rotation_x(0.37 * f64::from(turn)) * DQuat::from_rotation_y(0.6);
            vertices.extend(ball_vertices.iter().map(|&v| middle + 0.4 * (rotation * v)));
            faces.extend(ball_faces.iter().map(|face| face.map(|v| v + n)));
            let mesh = (vertices, faces);
            assert_eq!(selected(&mesh, 130, One), selected(&mesh, 130, All), "turn {turn}");
        }
    }

    #[test]
    fn noise_that_turns_single_faces_over_changes_nothing() {
        let (mut vertices, faces) = two_grids(12, 0.3, true);
        let n = vertices.len() / 2;
        fixtures::jitter(&mut vertices, 1.0, 4);
        let alone = (vertices[..n].to_vec(), faces[..faces.len() / 2].to_vec());
        let both = (vertices, faces);
        for face_id in 0..288 {
            assert_eq!(selected(&both, face_id, One), selected(&alone, face_id, All), "{face_id}");
        }
    }

    #[test]
    fn a_wall_that_ends_inside_the_patch_stays_whole() {
        // The two sides of the wall share the vertices of its rim at x = 0.
        let (vertices, faces) = two_grids(12, 0.5, true);
        let n = vertices.len() as u32 / 2;
        let on_rim = |v: u32| vertices[v as usize].x == 0.0;
        let joined: Vec<Face> =
            faces.iter().map(|f| f.map(|v| if v >= n && on_rim(v) { v - n } else { v })).collect();
        let wall = (vertices.clone(), joined);
        let mut seen = [0, 0];
        for face_id in 0..288 {
            let (one, all) = (selected(&wall, face_id, One), selected(&wall, face_id, All));
            let is_near = all.iter().any(|&f| wall.1[f as usize].iter().any(|&v| on_rim(v)));
            assert_eq!(one == all, is_near, "face {face_id}");
            seen[usize::from(is_near)] += 1;
        }
        assert!(seen.iter().all(|&count| count > 50), "{seen:?}");
    }

    #[test]
    fn a_centre_without_normal_opposes_nothing() {
        let (vertices, mut faces) = two_grids(6, 0.1, true);
        faces.truncate(73);
        faces[72] = [50, 50, 51];
        let mesh = (vertices, faces);
        assert_eq!(selected(&mesh, 72, One), selected(&mesh, 72, All));
    }
}
