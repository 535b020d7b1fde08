//! Nearest points on the input surface and on its feature curves: a tree of bounding boxes.

use glam::DVec3;

/// How many pieces a leaf holds at most.
const LEAF_SIZE: usize = 4;

/// A triangle, or a segment when its last two corners are equal, with the id of its region or chain.
#[derive(Debug, Clone, Copy)]
struct Piece {
    corners: [DVec3; 3],
    /// Unit normal; zero for segments and for triangles without area.
    normal: DVec3,
    id: u32,
}

#[derive(Debug, Clone, Copy)]
struct Node {
    lower: DVec3,
    upper: DVec3,
    /// First piece of a leaf, or the right child; the left child follows its parent.
    start: u32,
    /// Pieces in a leaf, 0 for an inner node.
    count: u32,
}

/// Answers nearest-point queries restricted to one region or chain.
#[derive(Debug, Clone, Default)]
pub(super) struct Surface {
    pieces: Vec<Piece>,
    nodes: Vec<Node>,
}

impl Surface {
    pub fn from_triangles(triangles: impl Iterator<Item = ([DVec3; 3], u32)>) -> Self {
        Self::build(
            triangles
                .map(|(corners, id)| {
                    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
                    Piece { corners, normal, id }
                })
                .filter(|piece| piece.normal != DVec3::ZERO)
                .collect(),
        )
    }

    pub fn from_segments(segments: impl Iterator<Item = ([DVec3; 2], u32)>) -> Self {
        Self::build(
            segments.map(|([a, b], id)| Piece { corners: [a, b, b], normal: DVec3::ZERO, id }).collect(),
        )
    }

    /// The nearest point to `point` among the pieces of `id` that do not face away from `normal`.
    ///
    /// The normal keeps a query from jumping through a thin wall; with a zero normal every piece counts.
    pub fn nearest(&self, point: DVec3, id: u32, normal: DVec3) -> Option<DVec3> {
        let mut best: Option<DVec3> = None;
        let mut best_squared = f64::INFINITY;
        let mut stack: Vec<(f64, u32)> = Vec::with_capacity(48);
        if !self.nodes.is_empty() {
            stack.push((0.0, 0));
        }
        while let Some((bound, node_id)) = stack.pop() {
            if bound >= best_squared {
                continue;
            }
            let node = self.nodes[node_id as usize];
            if node.count == 0 {
                let children = [node_id + 1, node.start].map(|child| (self.bound(child, point), child));
                let [near, far] =
                    if children[0].0 <= children[1].0 { children } else { [children[1], children[0]] };
                stack.push(far);
                stack.push(near);
                continue;
            }
            for piece in &self.pieces[node.start as usize..(node.start + node.count) as usize] {
                if piece.id != id || piece.normal.dot(normal) < 0.0 {
                    continue;
                }
                let candidate = nearest_on_piece(point, piece);
                let squared = candidate.distance_squared(point);
                if squared < best_squared {
                    best_squared = squared;
                    best = Some(candidate);
                }
            }
        }
        best
    }

    /// Squared distance from a point to a node's box.
    fn bound(&self, node_id: u32, point: DVec3) -> f64 {
        let node = &self.nodes[node_id as usize];
        point.clamp(node.lower, node.upper).distance_squared(point)
    }

    fn build(mut pieces: Vec<Piece>) -> Self {
        let mut nodes = Vec::new();
        if !pieces.is_empty() {
            let n_pieces = pieces.len();
            build_node(&mut pieces, 0, n_pieces, &mut nodes);
        }
        Self { pieces, nodes }
    }
}

/// Appends the subtree over `pieces[start..end]`, halved at the median of the longest axis.
fn build_node(pieces: &mut [Piece], start: usize, end: usize, nodes: &mut Vec<Node>) {
    let mut lower = DVec3::INFINITY;
    let mut upper = DVec3::NEG_INFINITY;
    for corner in pieces[start..end].iter().flat_map(|piece| piece.corners) {
        lower = lower.min(corner);
        upper = upper.max(corner);
    }
    let node_id = nodes.len();
    nodes.push(Node { lower, upper, start: start as u32, count: (end - start) as u32 });
    if end - start <= LEAF_SIZE {
        return;
    }
    let size = (upper - lower).to_array();
    let axis = (0..3).fold(0, |best, i| if size[i] > size[best] { i } else { best });
    let middle = (end - start) / 2;
    let centre = |piece: &Piece| piece.corners.iter().map(|corner| corner.to_array()[axis]).sum::<f64>();
    pieces[start..end].select_nth_unstable_by(middle, |p, q| centre(p).total_cmp(&centre(q)));
    build_node(pieces, start, start + middle, nodes);
    nodes[node_id].start = nodes.len() as u32;
    nodes[node_id].count = 0;
    build_node(pieces, start + middle, end, nodes);
}

fn nearest_on_piece(point: DVec3, piece: &Piece) -> DVec3 {
    let [a, b, c] = piece.corners;
    if piece.normal == DVec3::ZERO {
        nearest_on_segment(point, a, b)
    } else {
        nearest_on_triangle(point, a, b, c)
    }
}

/// The nearest point of the segment `a`–`b`.
pub(super) fn nearest_on_segment(point: DVec3, a: DVec3, b: DVec3) -> DVec3 {
    let along = b - a;
    let squared = along.length_squared();
    if squared > 0.0 { a + along * ((point - a).dot(along) / squared).clamp(0.0, 1.0) } else { a }
}

/// The nearest point of a triangle with area (Ericson, *Real-Time Collision Detection*, 2005, Sec. 5.1.5).
fn nearest_on_triangle(point: DVec3, a: DVec3, b: DVec3, c: DVec3) -> DVec3 {
    let (ab, ac) = (b - a, c - a);
    let (d1, d2) = (ab.dot(point - a), ac.dot(point - a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let (d3, d4) = (ab.dot(point - b), ac.dot(point - b));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let (d5, d6) = (ab.dot(point - c), ac.dot(point - c));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return nearest_on_segment(point, a, b);
    }
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return nearest_on_segment(point, a, c);
    }
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return nearest_on_segment(point, b, c);
    }
    let total = va + vb + vc;
    if total > 0.0 { a + ab * (vb / total) + ac * (vc / total) } else { a }
}
