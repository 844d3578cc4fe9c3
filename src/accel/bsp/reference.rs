//! The reference kernel: one ray, one plane, one triangle at a time, as the lecture walks a BSP tree.
//!
//! "Near side first; the other side if the ray crosses the boundary." What rounding asks for besides:
//!
//! * Planes are thick: by [`Slack`], so that a hit which the triangle test sees a little beside the true triangle is met
//!   from both sides of a plane close by.
//! * A ray that runs within a plane never divides by its zero component; it visits the side or sides it lies on.
//! * A hit counts wherever it lies, in this cell or not; the walk ends only when everything left lies beyond it.
//!
//! It is slow and stays so: the fast kernels are tested against it.

use glam::Vec3;

use super::builder::{Branch, Content};
use super::slack::{Line, Slack};

/// A tree of planes.
pub(super) struct PlaneTree {
    nodes: Vec<Node>,
    numbers: Vec<u32>,
    slack: Slack,
}

enum Node {
    Leaf {
        first: u32,
        count: u32,
    },
    /// The lower half follows, the upper one is at `above`.
    Cut {
        axis: usize,
        position: f32,
        above: u32,
    },
}

/// Whether a walk goes on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Walk {
    /// Up to this parameter.
    Until(f32),
    /// Not at all: the question is answered.
    Done,
}

impl PlaneTree {
    /// Lays out a built tree.
    pub(super) fn new(root: &Branch) -> PlaneTree {
        let mut tree = PlaneTree {
            nodes: Vec::new(),
            numbers: Vec::new(),
            slack: Slack::of(&root.cell),
        };
        tree.add(root);
        tree
    }

    fn add(&mut self, branch: &Branch) {
        match &branch.content {
            Content::Leaf(numbers) => {
                self.nodes.push(Node::Leaf {
                    first: self.numbers.len() as u32,
                    count: numbers.len() as u32,
                });
                self.numbers.extend_from_slice(numbers);
            }
            Content::Cut {
                axis,
                position,
                halves,
            } => {
                let here = self.nodes.len();
                self.nodes.push(Node::Leaf { first: 0, count: 0 });
                self.add(&halves[0]);
                let above = self.nodes.len() as u32;
                self.nodes[here] = Node::Cut {
                    axis: *axis,
                    position: *position,
                    above,
                };
                self.add(&halves[1]);
            }
        }
    }

    /// Bytes in use.
    pub(super) fn byte_count(&self) -> u64 {
        (size_of_val(&*self.nodes) + size_of_val(&*self.numbers)) as u64
    }

    /// Shows `visit` every primitive that the line may meet between `t_near` and `t_far`, nearest cells first; `visit`
    /// says how far the walk still has to go.
    pub(super) fn walk(
        &self,
        origin: Vec3,
        direction: Vec3,
        [t_near, t_far]: [f32; 2],
        mut visit: impl FnMut(u32) -> Walk,
    ) {
        let line = Line::new(origin.to_array(), direction.to_array());
        let mut end = t_far;
        let mut waiting = vec![(0u32, t_near, t_far)];
        while let Some((index, enter, leave)) = waiting.pop() {
            if enter > end {
                continue;
            }
            match self.nodes[index as usize] {
                Node::Leaf { first, count } => {
                    for &number in &self.numbers[first as usize..][..count as usize] {
                        match visit(number) {
                            Walk::Until(t) => end = t,
                            Walk::Done => return,
                        }
                    }
                }
                Node::Cut {
                    axis,
                    position,
                    above,
                } => {
                    let [low, high] = [(index + 1, -1.0), (above, 1.0)].map(|(child, side)| {
                        let [from, to] = line.half_space(axis, position, side, self.slack);
                        (child, enter.max(from), leave.min(to))
                    });
                    // The far side waits below the near one.
                    let order = if line.rises(axis) {
                        [high, low]
                    } else {
                        [low, high]
                    };
                    waiting.extend(order.into_iter().filter(|(_, from, to)| from <= to));
                }
            }
        }
    }
}
