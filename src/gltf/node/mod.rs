//! The node hierarchy, flattened: every node of the chosen scene with its transform to the world, in f64.

pub(super) mod animation;
mod animation_sampler;
pub(super) mod camera_light;
pub(super) mod gpu_instancing;
pub(super) mod node_transform;

use std::collections::HashMap;

use glam::{DAffine3, DMat4};

use crate::gltf::GltfError;
use crate::gltf::document::GltfDocument;
use crate::gltf::error::EXPORT_AGAIN;
use crate::gltf::extension::{Corrections, Extension};
use crate::gltf::node::node_transform::{NodeOverride, parts};

/// A node with its world transform.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::gltf) struct PlacedNode {
    pub(in crate::gltf) number: usize,
    pub(in crate::gltf) world_from_node: DAffine3,
    /// True unless the node or an ancestor is hidden by `KHR_node_visibility`, so that its meshes and lights are rendered.
    pub(in crate::gltf) is_visible: bool,
    /// Deformation of the node's mesh and the transform of the deformed mesh; `None` if the mesh is not deformed.
    pub(in crate::gltf) deformed: Option<Deformed>,
}

/// Deformation of a mesh and its transform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::gltf) struct Deformed {
    /// Index of the deformation in the list of all.
    pub(in crate::gltf) deformation: usize,
    pub(in crate::gltf) world_from_mesh: DAffine3,
}

/// Node whose children are still to be placed.
struct OpenNode {
    number: usize,
    world_from_parent: DAffine3,
    is_parent_visible: bool,
}

impl PlacedNode {
    /// Returns the mesh-to-world transform of the node's mesh.
    pub(in crate::gltf) fn world_from_mesh(&self) -> DAffine3 {
        self.deformed
            .map_or(self.world_from_node, |deformed| deformed.world_from_mesh)
    }
}

impl GltfDocument {
    /// Returns the nodes of the chosen scene, parents before children. The chosen scene is the one that the file names,
    /// else its first, else all nodes, with those without a parent as roots.
    ///
    /// `moved` are the properties that animations replace, by node number.
    pub(in crate::gltf) fn placed_nodes(
        &self,
        moved: &HashMap<usize, NodeOverride>,
    ) -> Result<Vec<PlacedNode>, GltfError> {
        let nodes = &self.root.nodes;
        let mut parents: Vec<Option<usize>> = vec![None; nodes.len()];
        let mut is_placed = vec![false; nodes.len()];
        let mut placed = Vec::new();
        let mut open: Vec<OpenNode> = Vec::new();
        for number in self.roots()?.into_iter().rev() {
            open.push(OpenNode {
                number,
                world_from_parent: DAffine3::IDENTITY,
                is_parent_visible: true,
            });
        }
        // An explicit stack, as files may nest deeper than the call stack allows.
        while let Some(next) = open.pop() {
            let number = next.number;
            if is_placed[number] {
                return Err(self.second_parent(number));
            }
            is_placed[number] = true;
            // Compose the transforms from the root down
            let node = &nodes[number];
            let world_from_node = next.world_from_parent * self.local_transform(number, moved)?;
            let is_visible = next.is_parent_visible && self.states_visible(number);
            placed.push(PlacedNode {
                number,
                world_from_node,
                is_visible,
                deformed: None,
            });
            // Push the children, each of which must have one parent only
            for child in node.children.iter().flatten().rev().map(|c| c.value()) {
                if child >= nodes.len() {
                    return Err(self.missing("node", child, nodes.len()));
                }
                if is_placed[child] || parents[child].is_some() {
                    parents[child].get_or_insert(number);
                    return Err(self.cycle_or_second_parent(child, number, &parents));
                }
                parents[child] = Some(number);
                open.push(OpenNode {
                    number: child,
                    world_from_parent: world_from_node,
                    is_parent_visible: is_visible,
                });
            }
        }
        Ok(placed)
    }

    /// Returns whether a node's own `KHR_node_visibility` shows it.
    fn states_visible(&self, number: usize) -> bool {
        let extensions = self.root.nodes[number].extensions.as_ref().map(|e| &e.others);
        let corrections = &mut Corrections::default();
        Extension::of(extensions, "KHR_node_visibility", corrections).flag("visible", true, corrections)
    }

    /// Returns a node's name for messages.
    pub(in crate::gltf) fn node_name(&self, number: usize) -> String {
        match &self.root.nodes[number].name {
            Some(name) if !name.is_empty() => name.clone(),
            _ => format!("node {number}"),
        }
    }

    fn roots(&self) -> Result<Vec<usize>, GltfError> {
        let (nodes, scenes) = (&self.root.nodes, &self.root.scenes);
        // Choose the scene
        let chosen = self.root.scene.map(|s| s.value());
        if let Some(number) = chosen.filter(|&n| n >= scenes.len()) {
            return Err(self.missing("scene", number, scenes.len()));
        }
        if let Some(scene) = scenes.get(chosen.unwrap_or(0)) {
            let roots: Vec<usize> = scene.nodes.iter().map(|n| n.value()).collect();
            return match roots.iter().find(|&&n| n >= nodes.len()) {
                Some(&outside) => Err(self.missing("node", outside, nodes.len())),
                None => Ok(roots),
            };
        }
        // Without a scene every node that is no child is a root
        let mut is_child = vec![false; nodes.len()];
        for child in nodes.iter().flat_map(|n| n.children.iter().flatten()) {
            if let Some(flag) = is_child.get_mut(child.value()) {
                *flag = true;
            }
        }
        let roots: Vec<usize> = (0..nodes.len()).filter(|&n| !is_child[n]).collect();
        if roots.is_empty() && !nodes.is_empty() {
            return Err(self.cycle(0));
        }
        Ok(roots)
    }

    /// Returns the node-to-parent transform.
    fn local_transform(
        &self,
        number: usize,
        moved: &HashMap<usize, NodeOverride>,
    ) -> Result<DAffine3, GltfError> {
        let node = &self.root.nodes[number];
        let transform = match (&node.matrix, moved.get(&number)) {
            (Some(matrix), _) => affine(matrix),
            (None, Some(moved)) => Some(moved.transform(node)),
            (None, None) => Some(parts(node).transform()),
        };
        match transform {
            Some(transform) if transform.is_finite() => Ok(transform),
            _ => {
                let fault = "has a matrix that is not finite or not affine";
                Err(self.fault(self.node_item(number), fault, "correct its transform"))
            }
        }
    }

    /// Returns a node's description in an error: its number and, if it has one, its name.
    pub(in crate::gltf) fn node_item(&self, number: usize) -> String {
        match &self.root.nodes[number].name {
            Some(name) if !name.is_empty() => format!("node {number} `{name}`"),
            _ => format!("node {number}"),
        }
    }

    fn cycle_or_second_parent(&self, child: usize, parent: usize, parents: &[Option<usize>]) -> GltfError {
        let mut ancestor = Some(parent);
        // At most one step per node: the chain of parents recorded so far has no cycle except through `child`.
        for _ in 0..parents.len() {
            match ancestor {
                Some(node) if node == child => return self.cycle(child),
                Some(node) => ancestor = parents[node],
                None => break,
            }
        }
        self.second_parent(child)
    }

    fn cycle(&self, node: usize) -> GltfError {
        self.fault(self.node_item(node), "is its own ancestor", EXPORT_AGAIN)
    }

    fn second_parent(&self, node: usize) -> GltfError {
        let fault = "is in the hierarchy twice";
        self.fault(self.node_item(node), fault, "give every node one parent")
    }
}

/// Returns the affine map of a column-major matrix; `None` unless its last row is that of an affine map.
fn affine(matrix: &[f32; 16]) -> Option<DAffine3> {
    let last_row = [matrix[3], matrix[7], matrix[11], matrix[15]];
    let matrix = DMat4::from_cols_array(&matrix.map(f64::from));
    (last_row == [0.0, 0.0, 0.0, 1.0]).then(|| DAffine3::from_mat4(matrix))
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use serde_json::{Value, json};

    use super::*;
    use crate::gltf::document::of_json;

    fn place(nodes: Value, roots: Value) -> Result<Vec<PlacedNode>, GltfError> {
        of_json(&json!({"asset": {"version": "2.0"}, "scenes": [{"nodes": roots}], "nodes": nodes}))
            .placed_nodes(&HashMap::new())
    }

    #[test]
    fn child_transform_is_relative_to_its_parent() {
        let nodes = json!([
            {"translation": [1, 2, 3], "scale": [2, 2, 2], "children": [1]},
            {"rotation": [0, 0, 3, 3], "translation": [1, 0, 0]}
        ]);
        let placed = place(nodes, json!([0])).unwrap();
        // A quarter turn about z (the quaternion is not of unit length and must be normalised): x to y, then doubled
        // and moved.
        let p = placed[1].world_from_node.transform_point3(DVec3::X);
        assert!((p - DVec3::new(3.0, 4.0, 3.0)).length() < 1e-15, "{p}");
    }

    #[test]
    fn descendants_of_a_hidden_node_are_hidden() {
        let hidden = json!({"KHR_node_visibility": {"visible": false}});
        let shown = json!({"KHR_node_visibility": {"visible": true}});
        let nodes = json!([
            {"children": [1, 3]}, {"extensions": hidden, "children": [2]}, {"extensions": shown}, {"extensions": shown}
        ]);
        let placed = place(nodes, json!([0])).unwrap();
        let visible: Vec<usize> = placed.iter().filter(|n| n.is_visible).map(|n| n.number).collect();
        assert_eq!(visible, [0, 3]);
    }

    #[test]
    fn cycles_and_second_parents_are_reported() {
        let fault = |nodes: Value, roots: Value| place(nodes, roots).unwrap_err().to_string();
        let cycle = json!([{"children": [1]}, {"children": [2]}, {"children": [0]}]);
        assert!(fault(cycle, json!([0])).contains("node 0 is its own ancestor"));
        let itself = json!([{"children": [0]}]);
        assert!(fault(itself, json!([0])).contains("its own ancestor"));
        let twice = json!([{"children": [2]}, {"children": [2]}, {"name": "leaf"}]);
        assert!(fault(twice, json!([0, 1])).contains("node 2 `leaf` is in the hierarchy twice"));
        assert!(fault(json!([{}]), json!([0, 0])).contains("node 0 is in the hierarchy twice"));
        assert!(fault(json!([{"children": [7]}]), json!([0])).contains("node 7"));
    }

    #[test]
    fn chain_of_a_hundred_thousand_nodes_is_traversed() {
        const DEPTH: usize = 100_000;
        let nodes: Vec<Value> = (0..DEPTH)
            .map(|i| {
                if i + 1 < DEPTH {
                    json!({"children": [i + 1], "translation": [1, 0, 0]})
                } else {
                    json!({})
                }
            })
            .collect();
        let placed = place(json!(nodes), json!([0])).unwrap();
        assert_eq!(
            placed[DEPTH - 1].world_from_node.translation.x,
            (DEPTH - 1) as f64
        );
    }

    #[test]
    fn parentless_nodes_are_roots_without_scenes() {
        let json = json!({"asset": {"version": "2.0"}, "nodes": [{}, {"children": [0]}, {}]});
        let placed = of_json(&json).placed_nodes(&HashMap::new()).unwrap();
        assert_eq!(placed.iter().map(|p| p.number).collect::<Vec<_>>(), [1, 0, 2]);
    }
}
