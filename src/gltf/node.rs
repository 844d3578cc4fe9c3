//! The node hierarchy, flattened: every node of the chosen scene with its place in the world, in f64.

use std::collections::HashMap;

use glam::{DAffine3, DMat4, DQuat, DVec3};
use gltf::json;

use super::GltfError;
use super::animation::NodeOverride;
use super::document::Document;
use super::error::EXPORT_AGAIN;

/// A node and its place.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PlacedNode {
    pub(super) number: usize,
    pub(super) world_from_node: DAffine3,
    /// What changes the vertices of its mesh, and where the mesh then stands; `None` where it stands as it is.
    pub(super) deformed: Option<Deformed>,
}

/// A mesh that is not shown as it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Deformed {
    /// Of the scene's deformations, this one.
    pub(super) deformation: usize,
    pub(super) world_from_mesh: DAffine3,
}

impl PlacedNode {
    /// Where its mesh stands.
    pub(super) fn world_from_mesh(&self) -> DAffine3 {
        self.deformed
            .map_or(self.world_from_node, |deformed| deformed.world_from_mesh)
    }
}

impl Document {
    /// The nodes of the chosen scene, parents before children: the scene that the file names, else its first, else
    /// every node without a parent is a root.
    ///
    /// `moved` are the places that a pose gives, by the numbers of nodes.
    pub(super) fn placed_nodes(
        &self,
        moved: &HashMap<usize, NodeOverride>,
    ) -> Result<Vec<PlacedNode>, GltfError> {
        let nodes = &self.root.nodes;
        let mut parents: Vec<Option<usize>> = vec![None; nodes.len()];
        let mut is_placed = vec![false; nodes.len()];
        let mut placed = Vec::new();
        let mut open: Vec<(usize, DAffine3)> = Vec::new();
        for root in self.roots()?.into_iter().rev() {
            open.push((root, DAffine3::IDENTITY));
        }
        // A stack of our own: files may nest deeper than the program's.
        while let Some((number, world_from_parent)) = open.pop() {
            if is_placed[number] {
                return Err(self.second_parent(number));
            }
            is_placed[number] = true;
            let node = &nodes[number];
            let world_from_node = world_from_parent * self.local_transform(number, moved)?;
            placed.push(PlacedNode {
                number,
                world_from_node,
                deformed: None,
            });
            for child in node.children.iter().flatten().rev().map(|c| c.value()) {
                if child >= nodes.len() {
                    return Err(self.missing("node", child, nodes.len()));
                }
                if is_placed[child] || parents[child].is_some() {
                    parents[child].get_or_insert(number);
                    return Err(self.cycle_or_second_parent(child, number, &parents));
                }
                parents[child] = Some(number);
                open.push((child, world_from_node));
            }
        }
        Ok(placed)
    }

    /// What messages call a node.
    pub(super) fn node_name(&self, number: usize) -> String {
        match &self.root.nodes[number].name {
            Some(name) if !name.is_empty() => name.clone(),
            _ => format!("node {number}"),
        }
    }

    fn roots(&self) -> Result<Vec<usize>, GltfError> {
        let (nodes, scenes) = (&self.root.nodes, &self.root.scenes);
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

    /// Node to parent.
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

    /// A node in an error: its number and, where it has one, its name.
    pub(super) fn node_item(&self, number: usize) -> String {
        match &self.root.nodes[number].name {
            Some(name) if !name.is_empty() => format!("node {number} `{name}`"),
            _ => format!("node {number}"),
        }
    }

    fn cycle_or_second_parent(&self, child: usize, parent: usize, parents: &[Option<usize>]) -> GltfError {
        let mut ancestor = Some(parent);
        // At most one step a node: the chain of parents recorded so far has no cycle but through `child`.
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
        let fault = "stands in the hierarchy twice";
        self.fault(self.node_item(node), fault, "give every node one parent")
    }
}

/// The affine map of a column-major matrix, if its last row says that it is one.
fn affine(matrix: &[f32; 16]) -> Option<DAffine3> {
    let last_row = [matrix[3], matrix[7], matrix[11], matrix[15]];
    let matrix = DMat4::from_cols_array(&matrix.map(f64::from));
    (last_row == [0.0, 0.0, 0.0, 1.0]).then(|| DAffine3::from_mat4(matrix))
}

/// What a node's place is made of: scale, then rotation, then translation.
pub(super) struct Parts {
    pub(super) scale: DVec3,
    pub(super) rotation: DQuat,
    pub(super) translation: DVec3,
}

impl Parts {
    pub(super) fn transform(&self) -> DAffine3 {
        DAffine3::from_scale_rotation_translation(self.scale, self.rotation, self.translation)
    }
}

/// A node's own.
pub(super) fn parts(node: &json::Node) -> Parts {
    let vector = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
    Parts {
        scale: node.scale.map_or(DVec3::ONE, vector),
        rotation: node.rotation.map_or(DQuat::IDENTITY, |q| {
            rotation(DQuat::from_array(q.0.map(f64::from)))
        }),
        translation: node.translation.map_or(DVec3::ZERO, vector),
    }
}

/// The rotation that a quaternion of any length names; one that names none means none.
pub(super) fn rotation(q: DQuat) -> DQuat {
    let length = q.length();
    if length > 0.0 && length.is_finite() {
        q * length.recip()
    } else {
        DQuat::IDENTITY
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use crate::gltf::document::of_json;

    fn place(nodes: Value, roots: Value) -> Result<Vec<PlacedNode>, GltfError> {
        of_json(&json!({"asset": {"version": "2.0"}, "scenes": [{"nodes": roots}], "nodes": nodes}))
            .placed_nodes(&HashMap::new())
    }

    #[test]
    fn a_child_stands_in_its_parents_space() {
        let nodes = json!([
            {"translation": [1, 2, 3], "scale": [2, 2, 2], "children": [1]},
            {"rotation": [0, 0, 3, 3], "translation": [1, 0, 0]}
        ]);
        let placed = place(nodes, json!([0])).unwrap();
        // A quarter turn about z (the quaternion is not unit and must be made so): x to y, then doubled and moved.
        let p = placed[1].world_from_node.transform_point3(DVec3::X);
        assert!((p - DVec3::new(3.0, 4.0, 3.0)).length() < 1e-15, "{p}");
    }

    #[test]
    fn cycles_and_second_parents_are_named() {
        let fault = |nodes: Value, roots: Value| place(nodes, roots).unwrap_err().to_string();
        let cycle = json!([{"children": [1]}, {"children": [2]}, {"children": [0]}]);
        assert!(fault(cycle, json!([0])).contains("node 0 is its own ancestor"));
        let itself = json!([{"children": [0]}]);
        assert!(fault(itself, json!([0])).contains("its own ancestor"));
        let twice = json!([{"children": [2]}, {"children": [2]}, {"name": "leaf"}]);
        assert!(fault(twice, json!([0, 1])).contains("node 2 `leaf` stands in the hierarchy twice"));
        assert!(fault(json!([{}]), json!([0, 0])).contains("node 0 stands in the hierarchy twice"));
        assert!(fault(json!([{"children": [7]}]), json!([0])).contains("node 7"));
    }

    #[test]
    fn a_chain_of_a_hundred_thousand_nodes_is_followed() {
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
    fn without_scenes_every_node_without_a_parent_is_a_root() {
        let json = json!({"asset": {"version": "2.0"}, "nodes": [{}, {"children": [0]}, {}]});
        let placed = of_json(&json).placed_nodes(&HashMap::new()).unwrap();
        assert_eq!(placed.iter().map(|p| p.number).collect::<Vec<_>>(), [1, 0, 2]);
    }
}
