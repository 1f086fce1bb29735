//! Implicit shapes that melt into each other, and their surface.

use crate::noise::fractal;
use crate::scene::mesh::Mesh;
use lumi_core::glam::{IVec3, Vec3};

/// One shape; lengths are in the shape's units.
#[derive(Clone, Copy, Debug)]
pub enum Shape {
    /// An ellipsoid with these half axes.
    Ellipsoid {
        /// Centre.
        centre: Vec3,
        /// Half axes.
        radii: Vec3,
    },
    /// A cone with round ends, from one ball to another.
    Bone {
        /// First centre.
        a: Vec3,
        /// Second centre.
        b: Vec3,
        /// Radius at the first.
        ra: f32,
        /// Radius at the second.
        rb: f32,
    },
    /// A rounded box.
    Block {
        /// Centre.
        centre: Vec3,
        /// Half sides.
        half: Vec3,
        /// Rounding.
        round: f32,
    },
    /// A ring about `axis`.
    Ring {
        /// Centre.
        centre: Vec3,
        /// Unit axis.
        axis: Vec3,
        /// Radius of the ring.
        radius: f32,
        /// Radius of its tube.
        tube: f32,
    },
}

/// A shape with the way it joins what was there before.
#[derive(Clone, Copy, Debug)]
pub struct Piece {
    /// The shape.
    pub shape: Shape,
    /// How far it melts into the others; 0 is a sharp union.
    pub blend: f32,
    /// Whether it is carved out instead of added.
    pub carve: bool,
    /// Material of the surface nearest to it.
    pub material: u16,
}

/// Pieces in order, with noise on the surface.
#[derive(Clone, Debug, Default)]
pub struct Sculpture {
    /// Joined from first to last; the first must not be carved.
    pub pieces: Vec<Piece>,
    /// Size of the displacement.
    pub bumps: f32,
    /// Frequency of the displacement.
    pub frequency: f32,
    /// Seed of the displacement.
    pub seed: u32,
}

impl Shape {
    /// Distance outside (about; exact near the surface for all but ellipsoids), negative inside.
    fn distance(&self, p: Vec3) -> f32 {
        match *self {
            Self::Ellipsoid { centre, radii } => {
                let q = (p - centre) / radii;
                let k = q.length();
                let gradient = (q / radii).length();
                if gradient < 1e-6 {
                    -radii.min_element()
                } else {
                    k * (k - 1.0) / gradient
                }
            }
            Self::Bone { a, b, ra, rb } => {
                let (pa, ba) = (p - a, b - a);
                let t = (pa.dot(ba) / ba.length_squared().max(1e-9)).clamp(0.0, 1.0);
                (pa - t * ba).length() - (ra + t * (rb - ra))
            }
            Self::Block {
                centre,
                half,
                round,
            } => {
                let q = (p - centre).abs() - half + round;
                q.max(Vec3::ZERO).length() + q.max_element().min(0.0) - round
            }
            Self::Ring {
                centre,
                axis,
                radius,
                tube,
            } => {
                let d = p - centre;
                let h = d.dot(axis);
                let r = (d - h * axis).length() - radius;
                (r * r + h * h).sqrt() - tube
            }
        }
    }

    fn bounds(&self) -> (Vec3, Vec3) {
        match *self {
            Self::Ellipsoid { centre, radii } => (centre - radii, centre + radii),
            Self::Bone { a, b, ra, rb } => ((a - ra).min(b - rb), (a + ra).max(b + rb)),
            Self::Block { centre, half, .. } => (centre - half, centre + half),
            Self::Ring {
                centre,
                radius,
                tube,
                ..
            } => (centre - radius - tube, centre + radius + tube),
        }
    }
}

impl Sculpture {
    /// Distance and the material of the piece that made it.
    fn field(&self, p: Vec3) -> (f32, u16) {
        let (mut d, mut material, mut nearest) = (f32::INFINITY, 0, f32::INFINITY);
        for piece in &self.pieces {
            let e = piece.shape.distance(p);
            if piece.carve {
                if -e > d {
                    material = piece.material;
                }
                d = -smooth_min(-d, e, piece.blend);
            } else {
                if e < nearest {
                    (nearest, material) = (e, piece.material);
                }
                d = smooth_min(d, e, piece.blend);
            }
        }
        if self.bumps > 0.0 && d.abs() < 2.0 * self.bumps {
            d += self.bumps * fractal(self.frequency * p, 3, self.seed);
        }
        (d, material)
    }

    /// The surface on a grid with `resolution` cells along the longest side: surface nets (one vertex per cell that
    /// the surface crosses, at the mean of its crossings, a quad per crossed edge).
    #[must_use]
    pub fn mesh(&self, resolution: usize) -> Mesh {
        let start = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        let added = self.pieces.iter().filter(|p| !p.carve);
        let (lo, hi) = added.fold(start, |(lo, hi), p| {
            let (a, b) = p.shape.bounds();
            (lo.min(a), hi.max(b))
        });
        let margin = 1.5 * self.bumps + 0.06 * (hi - lo).max_element();
        let (lo, hi) = (lo - margin, hi + margin);
        let cell = (hi - lo).max_element() / resolution as f32;
        let n = ((hi - lo) / cell).ceil().as_ivec3() + 1;
        let (nx, ny, nz) = (n.x as usize, n.y as usize, n.z as usize);
        let at = |x: usize, y: usize, z: usize| (z * ny + y) * nx + x;
        let point = |x: usize, y: usize, z: usize| {
            lo + cell * IVec3::new(x as i32, y as i32, z as i32).as_vec3()
        };
        let mut values = vec![0.0; nx * ny * nz];
        for z in 0..nz {
            for y in 0..ny {
                for x in 0..nx {
                    values[at(x, y, z)] = self.field(point(x, y, z)).0;
                }
            }
        }
        let mut mesh = Mesh::default();
        let mut vertex = vec![u32::MAX; values.len()];
        let mut materials = Vec::new();
        for z in 0..nz - 1 {
            for y in 0..ny - 1 {
                for x in 0..nx - 1 {
                    let corner = |i: usize| values[at(x + (i & 1), y + (i >> 1 & 1), z + (i >> 2))];
                    let inside = (0..8).filter(|&i| corner(i) < 0.0).count();
                    if inside == 0 || inside == 8 {
                        continue;
                    }
                    let (mut sum, mut crossings) = (Vec3::ZERO, 0.0);
                    for (i, j) in EDGES {
                        let (a, b) = (corner(i), corner(j));
                        if (a < 0.0) != (b < 0.0) {
                            sum += offset(i).lerp(offset(j), a / (a - b));
                            crossings += 1.0;
                        }
                    }
                    let p = point(x, y, z) + cell * sum / crossings;
                    vertex[at(x, y, z)] = mesh.positions.len() as u32;
                    mesh.positions.push(p);
                    mesh.normals.push(self.gradient(p, 0.5 * cell));
                    materials.push(self.field(p).1);
                }
            }
        }
        for z in 1..nz - 1 {
            for y in 1..ny - 1 {
                for x in 1..nx - 1 {
                    for axis in 0..3 {
                        let step = |k: usize| usize::from(k == axis);
                        let a = values[at(x, y, z)];
                        let b = values[at(x + step(0), y + step(1), z + step(2))];
                        if (a < 0.0) == (b < 0.0) {
                            continue;
                        }
                        // The four cells around this edge, in order.
                        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                        let quad = [(1, 1), (0, 1), (0, 0), (1, 0)].map(|(du, dv)| {
                            let mut c = [x, y, z];
                            c[u] -= du;
                            c[v] -= dv;
                            vertex[at(c[0], c[1], c[2])]
                        });
                        let [p, q, r, s] = if a < 0.0 {
                            quad
                        } else {
                            [quad[3], quad[2], quad[1], quad[0]]
                        };
                        for t in [[p, q, r], [p, r, s]] {
                            mesh.triangles.push(t);
                            mesh.material.push(materials[t[0] as usize]);
                        }
                    }
                }
            }
        }
        mesh.coords.clone_from(&mesh.positions);
        mesh
    }

    fn gradient(&self, p: Vec3, h: f32) -> Vec3 {
        let d = |v: Vec3| self.field(p + v).0 - self.field(p - v).0;
        Vec3::new(d(h * Vec3::X), d(h * Vec3::Y), d(h * Vec3::Z)).normalize_or(Vec3::Z)
    }
}

/// The twelve edges of a cell; corner `i` has its coordinates in the bits of `i`.
const EDGES: [(usize, usize); 12] = [
    (0, 1),
    (2, 3),
    (4, 5),
    (6, 7),
    (0, 2),
    (1, 3),
    (4, 6),
    (5, 7),
    (0, 4),
    (1, 5),
    (2, 6),
    (3, 7),
];

fn offset(corner: usize) -> Vec3 {
    Vec3::new(
        (corner & 1) as f32,
        (corner >> 1 & 1) as f32,
        (corner >> 2) as f32,
    )
}

/// Minimum that rounds the crease over a width of `k`.
fn smooth_min(a: f32, b: f32, k: f32) -> f32 {
    if k <= 0.0 || !a.is_finite() {
        return a.min(b);
    }
    let h = (k - (a - b).abs()).max(0.0) / k;
    a.min(b) - 0.25 * h * h * k
}
