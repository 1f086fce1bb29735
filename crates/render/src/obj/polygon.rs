//! Polygons as triangles.

use lumi_core::glam::{DVec2, DVec3};

/// Comparisons that all polygons of a file may take together, about a second's worth: enough for outlines of ten thousand
/// corners.
const WORK: usize = 200_000_000;

/// Cuts polygons into triangles, by ear clipping where they are not convex.
pub struct Clipper {
    /// Comparisons left.
    work: usize,
    /// Polygons that got triangles without further checks, because there was too much work.
    pub rough: usize,
}

/// Twice the polygon's area along its normal (Newell's sum; also right for corners that are not in one plane).
pub fn normal(corners: &[DVec3]) -> DVec3 {
    let Some(&origin) = corners.first() else {
        return DVec3::ZERO;
    };
    let edges = corners.windows(2);
    edges.map(|e| (e[0] - origin).cross(e[1] - origin)).sum()
}

/// Twice the signed area of a triangle.
fn area(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - a)
}

impl Clipper {
    /// For one file.
    pub fn new() -> Self {
        Self {
            work: WORK,
            rough: 0,
        }
    }

    /// Appends triangles that cover the polygon once, as indices of its corners; corners that lie on a line with their
    /// neighbours may be left out. Triangles stay as they are, and polygons that cross themselves get some triangles.
    pub fn triangulate(&mut self, corners: &[DVec3], triangles: &mut Vec<[usize; 3]>) {
        let n = corners.len();
        let fan = |triangles: &mut Vec<_>| triangles.extend((2..n).map(|i| [0, i - 1, i]));
        let up = normal(corners).normalize_or_zero();
        if n <= 3 || up == DVec3::ZERO {
            fan(triangles);
            return;
        }
        let (x, y) = up.any_orthonormal_pair();
        let flat = |p: &DVec3| DVec2::new((p - corners[0]).dot(x), (p - corners[0]).dot(y));
        let flat: Vec<DVec2> = corners.iter().map(flat).collect();
        // Seen from the first corner the others follow each other: nothing can overlap.
        if (2..n).all(|i| area(flat[0], flat[i - 1], flat[i]) > 0.0) {
            fan(triangles);
        } else {
            let before = triangles.len();
            self.clip(&flat, triangles);
            if triangles.len() == before {
                fan(triangles);
            }
        }
    }

    /// Ear clipping of a counter-clockwise polygon.
    fn clip(&mut self, points: &[DVec2], triangles: &mut Vec<[usize; 3]>) {
        let n = points.len();
        let mut next: Vec<usize> = (1..n).chain([0]).collect();
        let mut before: Vec<usize> = [n - 1].into_iter().chain(0..n - 1).collect();
        let turn = |a: usize, b: usize, c: usize| area(points[a], points[b], points[c]);
        // Only corners that are not convex can lie in an ear, and a convex one stays so.
        let mut hollow: Vec<usize> = (0..n)
            .filter(|&i| turn(before[i], i, next[i]) <= 0.0)
            .collect();
        let (mut left, mut at, mut tried, mut rough) = (n, 0, 0, false);
        while left > 3 {
            let (a, c) = (before[at], next[at]);
            let size = turn(a, at, c);
            self.work = self
                .work
                .saturating_sub(if size > 0.0 { hollow.len() } else { 1 });
            rough |= self.work == 0;
            let corners = [a, at, c].map(|i| points[i]);
            let free = || !hollow.iter().any(|&p| inside(corners, points[p]));
            // A polygon that crosses itself may have no ear; then any corner goes.
            if rough || size == 0.0 || (size > 0.0 && free()) || tried >= left {
                if size != 0.0 {
                    triangles.push(if size > 0.0 { [a, at, c] } else { [a, c, at] });
                }
                (next[a], before[c]) = (c, a);
                left -= 1;
                tried = 0;
                if !rough {
                    self.work = self.work.saturating_sub(hollow.len());
                    hollow.retain(|&p| p != at && turn(before[p], p, next[p]) <= 0.0);
                }
                // Going on beyond the neighbour makes fewer slivers.
                at = next[c];
            } else {
                tried += 1;
                at = c;
            }
        }
        let (a, c) = (before[at], next[at]);
        if turn(a, at, c) != 0.0 {
            triangles.push([a, at, c]);
        }
        self.rough += usize::from(rough);
    }
}

/// Whether `p` lies in the triangle or on its edges, but is none of its corners.
fn inside([a, b, c]: [DVec2; 3], p: DVec2) -> bool {
    area(a, b, p) >= 0.0
        && area(b, c, p) >= 0.0
        && area(c, a, p) >= 0.0
        && p != a
        && p != b
        && p != c
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(corners: &[[f64; 2]]) -> Vec<[usize; 3]> {
        // Tilted out of the axes' planes.
        let lifted: Vec<DVec3> = corners
            .iter()
            .map(|&[x, y]| DVec3::new(x, y, 0.5 * x - 0.25 * y))
            .collect();
        let mut triangles = Vec::new();
        Clipper::new().triangulate(&lifted, &mut triangles);
        triangles
    }

    /// How often each of many points of the polygon's box is covered.
    fn covered(corners: &[[f64; 2]], triangles: &[[usize; 3]], p: DVec2) -> usize {
        let at = |i: usize| DVec2::from_array(corners[i]);
        let within = |t: &&[usize; 3]| {
            let [a, b, c] = t.map(at);
            let signs = [area(a, b, p), area(b, c, p), area(c, a, p)];
            signs.iter().all(|&s| s > 0.0) || signs.iter().all(|&s| s < 0.0)
        };
        triangles.iter().filter(within).count()
    }

    #[test]
    fn concave_polygons_are_covered_once_and_nothing_else_is() {
        let arrow = vec![[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]];
        let dart = vec![[0.0, 0.0], [4.0, 1.0], [0.0, 2.0], [1.0, 1.0]];
        let comb: Vec<[f64; 2]> = (0..40)
            .map(|i| [f64::from(i), if i % 2 == 0 { 1.0 } else { 9.0 }])
            .chain([[39.0, -1.0], [0.0, -1.0]])
            .collect();
        // Two keyholes: a square ring whose cut is passed twice.
        let ring = vec![
            [0.0, 0.0],
            [6.0, 0.0],
            [6.0, 6.0],
            [0.0, 6.0],
            [0.0, 0.0],
            [2.0, 2.0],
            [2.0, 4.0],
            [4.0, 4.0],
            [4.0, 2.0],
            [2.0, 2.0],
        ];
        for mut corners in [arrow, dart, comb, ring] {
            for _ in 0..2 {
                let triangles = cut(&corners);
                for i in 0..61 {
                    for j in 0..61 {
                        let p = DVec2::new(
                            f64::from(i) * 0.663 + 0.0137,
                            f64::from(j) * 0.171 - 1.0071,
                        );
                        let expected = usize::from(even_odd(&corners, p));
                        assert_eq!(covered(&corners, &triangles, p), expected, "{p}");
                    }
                }
                corners.reverse();
            }
        }
    }

    /// Whether a ray from `p` crosses the outline an odd number of times.
    fn even_odd(corners: &[[f64; 2]], p: DVec2) -> bool {
        let n = corners.len();
        let crossed = (0..n).filter(|&i| {
            let ([x, y], [u, v]) = (corners[i], corners[(i + 1) % n]);
            (y > p.y) != (v > p.y) && p.x < (u - x) * (p.y - y) / (v - y) + x
        });
        crossed.count() % 2 == 1
    }

    #[test]
    fn odd_polygons_end() {
        assert_eq!(
            cut(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]).len(),
            2
        );
        assert_eq!(cut(&[[0.0, 0.0]; 5]).len(), 3);
        // Collinear, doubled and self-crossing.
        assert!(!cut(&[[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 2.0]]).is_empty());
        let star: Vec<[f64; 2]> = (0..5)
            .map(|i| {
                let (s, c) = (f64::from(i) * 0.8 * std::f64::consts::PI).sin_cos();
                [c, s]
            })
            .collect();
        assert!(!cut(&star).is_empty());
        // More hollow corners than there is work for.
        let saw: Vec<DVec3> = (0..2000)
            .map(|i| {
                let x = f64::from(i);
                DVec3::new(x, f64::from(i % 2) + x * x * 1e-2, 0.0)
            })
            .collect();
        for (work, rough) in [(WORK, 0), (10_000, 1)] {
            let mut clipper = Clipper { work, rough: 0 };
            let mut triangles = Vec::new();
            clipper.triangulate(&saw, &mut triangles);
            assert_eq!(clipper.rough, rough);
            assert!(triangles.len() > 1000, "{}", triangles.len());
        }
    }
}
