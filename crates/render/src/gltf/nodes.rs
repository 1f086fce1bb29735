//! Where the nodes of a glTF scene are, and how skins bend the meshes at them.

use super::accessor::{Buffers, Floats};
use gltf::{Document, Node, Primitive, Semantic};
use lumi_core::glam::{DMat4, DVec3, Mat4, Vec3};
use lumi_core::{Error, Result};
use std::collections::HashSet;
use std::path::Path;

/// The nodes of a document.
pub struct Nodes<'a> {
    /// Those of the scene that can be seen, in its order.
    pub shown: Vec<Node<'a>>,
    /// From each node's space to the world's.
    pub world: Vec<DMat4>,
}

impl<'a> Nodes<'a> {
    /// From the transforms of each node to its parent's space.
    pub fn new(path: &Path, document: &'a Document, local: &[DMat4]) -> Result<Self> {
        let children: HashSet<usize> = document
            .nodes()
            .flat_map(|n| n.children())
            .map(|child| child.index())
            .collect();
        let roots = || document.nodes().filter(|n| !children.contains(&n.index()));
        let scene = document.default_scene();
        let scene = scene.or_else(|| document.scenes().next());
        let mut nodes = Self {
            shown: Vec::new(),
            world: vec![DMat4::IDENTITY; local.len()],
        };
        let mut seen = vec![false; document.nodes().len()];
        let twice = match &scene {
            Some(scene) => nodes.walk(scene.nodes().collect(), local, &mut seen),
            None => nodes.walk(roots().collect(), local, &mut seen),
        };
        if let Some(index) = twice {
            let expected = "expected a tree, found a node with two parents";
            return Err(Error::invalid(path, format!("nodes[{index}]"), expected));
        }
        // Joints may be outside of the scene.
        let shown = nodes.shown.len();
        let rest = roots().filter(|n| !seen[n.index()]).collect();
        nodes.walk(rest, local, &mut seen);
        nodes.shown.truncate(shown);
        Ok(nodes)
    }

    /// Goes down from `roots`; the first node that is found twice is not gone down from again.
    fn walk(&mut self, roots: Vec<Node<'a>>, local: &[DMat4], seen: &mut [bool]) -> Option<usize> {
        let mut twice = None;
        let mut open: Vec<(Node<'a>, DMat4, bool)> = roots
            .into_iter()
            .map(|n| (n, DMat4::IDENTITY, true))
            .collect();
        open.reverse();
        while let Some((node, parent, visible)) = open.pop() {
            let index = node.index();
            if std::mem::replace(&mut seen[index], true) {
                twice.get_or_insert(index);
                continue;
            }
            let world = parent * local[index];
            self.world[index] = world;
            let said = node.extension_value("KHR_node_visibility");
            let said = said.and_then(|v| v.get("visible")?.as_bool());
            let visible = visible && said.unwrap_or(true);
            let first = open.len();
            open.extend(node.children().map(|c| (c, world, visible)));
            open[first..].reverse();
            if visible {
                self.shown.push(node);
            }
        }
        twice
    }
}

/// A node's skin: for each joint, from the mesh's space to the world's.
pub struct Skin(Vec<DMat4>);

/// Joints and weights of a primitive's vertices.
type Bound<'a> = Vec<(Floats<'a, 4>, Floats<'a, 4>)>;

impl Skin {
    /// In the pose in which the nodes are.
    pub fn new(
        buffers: &Buffers,
        skin: &gltf::Skin<'_>,
        nodes: &Nodes<'_>,
    ) -> std::result::Result<Self, String> {
        let inverse = skin.inverse_bind_matrices();
        let inverse = inverse.map(|a| buffers.floats::<16>(&a)).transpose()?;
        let joints = skin.joints().enumerate().map(|(i, joint)| {
            let bind = inverse.as_ref().and_then(|m| m.get(i));
            let bind = bind.map_or(DMat4::IDENTITY, |m| Mat4::from_cols_array(&m).as_dmat4());
            nodes.world[joint.index()] * bind
        });
        Ok(Self(joints.collect()))
    }

    /// Which joints move the vertices of a primitive; empty if it does not say.
    pub fn bound<'b>(
        buffers: &'b Buffers,
        primitive: &Primitive<'_>,
    ) -> std::result::Result<Bound<'b>, String> {
        let mut all = Vec::new();
        while let (Some(joints), Some(weights)) = (
            primitive.get(&Semantic::Joints(all.len() as u32)),
            primitive.get(&Semantic::Weights(all.len() as u32)),
        ) {
            all.push((buffers.floats(&joints)?, buffers.floats(&weights)?));
        }
        Ok(all)
    }

    /// Where vertex `i` goes: from the mesh's space to the world's.
    pub fn at(&self, bound: &Bound<'_>, i: usize) -> std::result::Result<DMat4, String> {
        let (mut sum, mut total) = (DMat4::ZERO, 0.0);
        for (joints, weights) in bound {
            let (Some(joints), Some(weights)) = (joints.get(i), weights.get(i)) else {
                break;
            };
            for (joint, weight) in joints.into_iter().zip(weights) {
                if weight == 0.0 || !weight.is_finite() {
                    continue;
                }
                let n = self.0.len();
                let matrix = self.0.get(joint as usize);
                let matrix = matrix.ok_or(format!("expected joints below {n}, found {joint}"))?;
                sum += *matrix * f64::from(weight);
                total += f64::from(weight);
            }
        }
        // A vertex that nothing moves stays where the mesh has it.
        Ok(if total > 0.0 {
            sum * total.recip()
        } else {
            DMat4::IDENTITY
        })
    }
}

/// A position in f64.
pub fn moved(transform: &DMat4, p: Vec3) -> DVec3 {
    transform.transform_point3(p.as_dvec3())
}
