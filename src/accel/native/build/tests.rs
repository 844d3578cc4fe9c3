//! Tests of the builder.

use crate::mesh::{Mesh, bumpy_sphere};

use super::build_tree;
use crate::accel::native::layout::{ChildLink, GroupTree, NO_NUMBER};

/// Returns the mesh of separate triangles.
fn soup(corners: impl IntoIterator<Item = [[f32; 3]; 3]>) -> Mesh {
    let positions: Vec<[f32; 3]> = corners.into_iter().flatten().collect();
    let triangles: Vec<[u32; 3]> = (0..positions.len() as u32 / 3)
        .map(|i| [3 * i, 3 * i + 1, 3 * i + 2])
        .collect();
    Mesh {
        positions: positions.into(),
        triangles: triangles.into(),
        ..Mesh::default()
    }
}

/// Checks that every triangle is in exactly one block, with its vertices, and that boxes contain what is below.
fn check(meshes: &[&Mesh]) -> GroupTree {
    let tree = build_tree(meshes).unwrap();
    let corners: Vec<[glam::Vec3; 3]> = meshes
        .iter()
        .flat_map(|mesh| (0..mesh.triangles.len() as u32).map(|number| mesh.corners(number)))
        .collect();
    // Visit all nodes and blocks with the bounds and depths of their parents
    let mut counts = vec![0; corners.len()];
    let everything = [[f32::NEG_INFINITY; 3], [f32::INFINITY; 3]];
    let mut waiting = vec![(tree.root, everything, 1)];
    while let Some((child, [low, high], depth)) = waiting.pop() {
        assert!(depth < crate::accel::native::layout::MAX_DEPTH);
        if child == ChildLink::EMPTY {
            assert!(corners.is_empty());
        } else if child.is_leaf() {
            let block = &tree.blocks[child.index()];
            for (lane, &number) in block.numbers.iter().enumerate() {
                let triangle = block.triangles.triangle(lane);
                if number == NO_NUMBER {
                    assert!(triangle.as_flattened().iter().all(|x| x.is_nan()));
                    continue;
                }
                counts[number as usize] += 1;
                assert_eq!(triangle, corners[number as usize].map(|p| p.to_array()));
                for (axis, x) in triangle.iter().flat_map(|p| p.iter().enumerate()) {
                    assert!(low[axis] <= *x && *x <= high[axis]);
                }
            }
        } else {
            let node = &tree.nodes[child.index()];
            for slot in 0..8 {
                let bounds = [0, 1].map(|side| [0, 1, 2].map(|axis| node.bounds[side][axis][slot]));
                if node.children[slot] == ChildLink::EMPTY {
                    assert_eq!(bounds, [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]]);
                    continue;
                }
                for axis in 0..3 {
                    assert!(low[axis] <= bounds[0][axis] && bounds[1][axis] <= high[axis]);
                }
                waiting.push((node.children[slot], bounds, depth + 1));
            }
        }
    }
    assert!(counts.iter().all(|&count| count == 1));
    tree
}

/// Returns pseudo-random numbers in [0, 1).
fn random(state: &mut u64) -> f32 {
    *state = state
        .wrapping_mul(6364136223846793005)
        .wrapping_add(1442695040888963407);
    (*state >> 40) as f32 / (1u64 << 24) as f32
}

#[test]
fn every_triangle_is_in_one_block_and_boxes_contain_it() {
    for count in [12, 100, 3000, 200_000] {
        let tree = check(&[&bumpy_sphere(count)]);
        let bytes = tree.byte_count() as f64 / count as f64;
        assert!(count < 3000 || bytes < 60.0, "{bytes}");
    }
    check(&[
        &bumpy_sphere(5000),
        &Mesh::default(),
        &bumpy_sphere(12),
        &bumpy_sphere(700),
    ]);
}

#[test]
fn few_and_degenerate_triangles_make_a_tree() {
    check(&[]);
    check(&[&Mesh::default()]);
    let mut state = 1;
    for count in [1, 2, 7, 8, 9, 65, 513, 5000] {
        // All at one point, on a line, and random
        check(&[&soup((0..count).map(|_| [[1.0, 2.0, 3.0]; 3]))]);
        check(&[&soup(
            (0..count).map(|i| [0.0, 0.5, 1.0].map(|x| [i as f32 + x, 0.0, 0.0])),
        )]);
        let huge = |state: &mut u64| [0; 3].map(|_| (random(state) - 0.5) * 1.8e19);
        check(&[&soup((0..count).map(|_| [0; 3].map(|_| huge(&mut state))))]);
        // Sizes from 1e-6 to 1, long and thin
        check(&[&soup((0..count).map(|_| {
            let size = 1e-6f32.powf(random(&mut state));
            let centre = [0; 3].map(|_| random(&mut state));
            [0, 1, 2].map(|v| [0, 1, 2].map(|a| centre[a] + size * if v == a { 10.0 } else { 0.01 }))
        }))]);
        // Distances from the origin that double: as deep as it gets
        check(&[&soup((0..count).map(|i| [[2f32.powi(i % 120 - 60); 3]; 3]))]);
    }
}

#[test]
fn tree_does_not_depend_on_the_number_of_threads() {
    let mesh = bumpy_sphere(300_000);
    let trees = [1, 2, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| build_tree(&[&mesh]).unwrap())
    });
    for tree in &trees[1..] {
        assert_eq!(tree.root, trees[0].root);
        let same = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits());
        assert_eq!(tree.nodes.len(), trees[0].nodes.len());
        for (a, b) in tree.nodes.iter().zip(&*trees[0].nodes) {
            let flat = |n: &crate::accel::native::layout::NativeNode| {
                n.bounds.as_flattened().as_flattened().to_vec()
            };
            assert!(a.children == b.children && same(&flat(a), &flat(b)));
        }
        assert_eq!(tree.blocks.len(), trees[0].blocks.len());
        for (a, b) in tree.blocks.iter().zip(&*trees[0].blocks) {
            let flat = |n: &crate::accel::native::layout::LeafBlock| {
                n.triangles.corners.as_flattened().as_flattened().to_vec()
            };
            assert!(a.numbers == b.numbers && same(&flat(a), &flat(b)));
        }
    }
}
