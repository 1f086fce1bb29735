//! Pieces from which objects are assembled.

use crate::material::Material;
use crate::scene::mesh::{Mesh, Model};
use lumi_core::glam::{Affine3A, Mat3, Vec3};

/// A surface with shared vertices, before shading normals are made.
#[derive(Clone, Debug, Default)]
pub struct Part {
    /// Where the vertices are.
    pub positions: Vec<Vec3>,
    /// Where the vertices were in the part's own frame: its texture space.
    pub coords: Vec<Vec3>,
    /// Vertex indices.
    pub triangles: Vec<[u32; 3]>,
    /// Edges sharper than this angle in radians stay sharp.
    pub crease: f32,
}

impl Part {
    /// A part whose texture space is its own frame.
    #[must_use]
    pub fn new(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>, crease: f32) -> Self {
        Self {
            coords: positions.clone(),
            positions,
            triangles,
            crease,
        }
    }

    /// A closed or open grid of `rows × columns` vertices; `wrap` joins the last column (and row) to the first.
    #[must_use]
    pub fn grid(positions: Vec<Vec3>, columns: usize, wrap: (bool, bool), crease: f32) -> Self {
        let rows = positions.len() / columns;
        let (last_row, last_column) = (
            if wrap.0 { rows } else { rows - 1 },
            if wrap.1 { columns } else { columns - 1 },
        );
        let mut triangles = Vec::with_capacity(2 * last_row * last_column);
        for r in 0..last_row {
            for c in 0..last_column {
                let (r1, c1) = ((r + 1) % rows, (c + 1) % columns);
                let [a, b, d, e] =
                    [(r, c), (r, c1), (r1, c), (r1, c1)].map(|(r, c)| (r * columns + c) as u32);
                triangles.push([a, b, e]);
                triangles.push([a, e, d]);
            }
        }
        Self::new(positions, triangles, crease)
    }

    /// The part moved by `t`; its texture stays attached.
    #[must_use]
    pub fn moved(mut self, t: &Affine3A) -> Self {
        for p in &mut self.positions {
            *p = t.transform_point3(*p);
        }
        self
    }

    /// The part at `position`.
    #[must_use]
    pub fn at(self, position: Vec3) -> Self {
        self.moved(&Affine3A::from_translation(position))
    }

    /// The part turned by `rotation`.
    #[must_use]
    pub fn turned(self, rotation: Mat3) -> Self {
        self.moved(&Affine3A::from_mat3(rotation))
    }

    /// The part stretched along the axes.
    #[must_use]
    pub fn scaled(self, scale: Vec3) -> Self {
        self.moved(&Affine3A::from_scale(scale))
    }

    /// The part with its z axis turned to `direction`.
    #[must_use]
    pub fn aimed(self, direction: Vec3) -> Self {
        let z = direction.normalize_or(Vec3::Z);
        let (x, y) = crate::sampling::frame(z);
        self.turned(Mat3::from_cols(x, y, z))
    }

    /// The mirror image in the plane y = 0.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        let mut copy = self.clone();
        for p in &mut copy.positions {
            p.y = -p.y;
        }
        for t in &mut copy.triangles {
            t.swap(0, 1);
        }
        copy
    }

    /// Unshared vertices where normals differ, all of material `material`.
    #[must_use]
    pub fn mesh(&self, material: u16) -> Mesh {
        let face = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| self.positions[i as usize]);
            (b - a).cross(c - a)
        };
        let normals: Vec<Vec3> = self.triangles.iter().map(face).collect();
        let mut around: Vec<Vec<u32>> = vec![Vec::new(); self.positions.len()];
        for (i, t) in self.triangles.iter().enumerate() {
            for &v in t {
                around[v as usize].push(i as u32);
            }
        }
        let limit = self.crease.cos();
        let mut mesh = Mesh::default();
        for (i, t) in self.triangles.iter().enumerate() {
            let own = normals[i].normalize_or_zero();
            if own == Vec3::ZERO {
                continue;
            }
            let base = mesh.positions.len() as u32;
            for &v in t {
                // Area-weighted mean of the faces that meet here smoothly.
                let normal: Vec3 = around[v as usize]
                    .iter()
                    .map(|&f| normals[f as usize])
                    .filter(|n| n.dot(own) >= limit * n.length())
                    .sum();
                mesh.positions.push(self.positions[v as usize]);
                mesh.coords.push(self.coords[v as usize]);
                mesh.normals.push(normal.normalize_or(own));
            }
            mesh.triangles.push([base, base + 1, base + 2]);
            mesh.material.push(material);
        }
        mesh
    }
}

/// Parts and their materials on the way to a [`Model`].
#[derive(Default)]
pub struct Assembly {
    model: Model,
}

impl Assembly {
    /// Registers a material for [`Self::add`].
    pub fn material(&mut self, material: Material) -> u16 {
        self.model.materials.push(material);
        (self.model.materials.len() - 1) as u16
    }

    /// Adds a part.
    pub fn add(&mut self, part: &Part, material: u16) {
        self.model.mesh.append(&part.mesh(material), 0);
    }

    /// Adds a part and its mirror image in y = 0.
    pub fn add_pair(&mut self, part: &Part, material: u16) {
        self.add(part, material);
        self.add(&part.mirrored(), material);
    }

    /// Adds a finished mesh whose materials are already registered here.
    pub fn add_mesh(&mut self, mesh: &Mesh) {
        self.model.mesh.append(mesh, 0);
    }

    /// The model.
    #[must_use]
    pub fn finish(self) -> Model {
        self.model
    }
}
