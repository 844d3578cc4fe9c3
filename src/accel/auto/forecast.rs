//! Forecast of the time that Embree and the native tree take to build and to trace a render's rays.

use std::fmt;

use crate::scene::{Geometry, Scene};

/// Expected numbers of a render's rays, by what a backend can make of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayForecast {
    /// Camera rays from one point.
    pub from_point: f64,
    /// Shadow rays to one point, from neighbouring points of the first surface.
    pub to_point: f64,
    /// Other rays with coherent neighbours: camera rays through a lens, and shadow rays from the first surface to an
    /// area.
    pub coherent: f64,
    /// Rays after a bounce, with their shadow rays.
    pub incoherent: f64,
}

impl Default for RayForecast {
    /// Returns the rays of an image of a million pixels with a sample and a lamp each.
    fn default() -> RayForecast {
        RayForecast {
            from_point: 1e6,
            to_point: 1e6,
            coherent: 0.0,
            incoherent: 0.0,
        }
    }
}

/// Objects of a scene, by how the native backend holds them.
#[derive(Clone, Copy)]
struct SceneSize {
    /// Triangles of baked meshes.
    triangles: f64,
    /// Shapes, and triangles of instanced meshes.
    others: f64,
}

impl SceneSize {
    fn of(scene: &Scene) -> SceneSize {
        let mut size = SceneSize {
            triangles: 0.0,
            others: 0.0,
        };
        for instance in &scene.instances {
            let geometry = &scene.geometries[instance.geometry as usize];
            let count = geometry.primitive_count() as f64;
            match geometry {
                Geometry::Mesh(_) if instance.is_identity() => size.triangles += count,
                geometry if geometry.is_unbounded() => {}
                _ => size.others += count,
            }
        }
        size
    }
}

/// Processor time of a kind of rays, in nanoseconds.
#[derive(Clone, Copy)]
struct RayCost {
    /// Time of a ray where others have brought its nodes and triangles into cache.
    ray: f64,
    /// Time of the first ray that reaches a triangle, beside that.
    triangle: f64,
}

impl RayCost {
    /// Returns the time of `count` rays in a scene of this many triangles, half of which are hidden.
    fn nanoseconds(self, count: f64, triangles: f64) -> f64 {
        self.ray * count + self.triangle * count.min(0.5 * triangles)
    }
}

/// Processor time of a backend, in nanoseconds.
struct BackendCosts {
    /// Time of starting it.
    start: f64,
    /// Build time of a triangle.
    triangle: f64,
    from_point: RayCost,
    to_point: RayCost,
    coherent: RayCost,
    incoherent: RayCost,
}

// Measured on a Xeon with AVX-512 with `whit render --stats -` of `bumpy2m.glb`, and `whit bench` of it and of a mesh of
// 15 000 triangles. Only their ratios count.

/// Costs of Embree 3.13.5 at its watertight precision.
const EMBREE: BackendCosts = BackendCosts {
    start: 3e6,
    triangle: 720.0,
    from_point: RayCost {
        ray: 45.0,
        triangle: 100.0,
    },
    to_point: RayCost {
        ray: 70.0,
        triangle: 120.0,
    },
    coherent: RayCost {
        ray: 100.0,
        triangle: 120.0,
    },
    incoherent: RayCost {
        ray: 300.0,
        triangle: 0.0,
    },
};
/// Costs of the native tree.
const NATIVE: BackendCosts = BackendCosts {
    start: 0.0,
    triangle: 150.0,
    from_point: RayCost {
        ray: 38.0,
        triangle: 45.0,
    },
    to_point: RayCost {
        ray: 45.0,
        triangle: 95.0,
    },
    coherent: RayCost {
        ray: 300.0,
        triangle: 0.0,
    },
    incoherent: RayCost {
        ray: 290.0,
        triangle: 0.0,
    },
};
/// Build time of an object in the BSP beside the native tree, in nanoseconds.
const OBJECT_BUILD: f64 = 1500.0;
/// Time of a ray in that BSP, and its part for each doubling of the number of objects.
const OBJECT_RAY: f64 = 40.0;
const OBJECT_DOUBLING: f64 = 10.0;

/// Structures that serve a render's rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Structures {
    /// Embree's for all rays.
    Embree,
    /// The native tree for all rays.
    Native,
    /// The native tree for rays with a common end, Embree's for all others.
    Both,
}

/// Choice between Embree and the native tree, with the forecast on which it stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// Structures with the least time.
    pub structures: Structures,
    /// Forecast of processor seconds to build the chosen structures and to trace all rays.
    pub seconds: f64,
    /// The same for Embree alone.
    pub embree_seconds: f64,
}

impl Choice {
    /// Chooses the structures for a scene and the rays of its render. The choice depends on nothing else, so that images
    /// have the same bits on any machine.
    pub fn new(scene: &Scene, rays: &RayForecast) -> Choice {
        let size = SceneSize::of(scene);
        let embree_seconds = 1e-9
            * embree(
                size,
                [rays.from_point, rays.to_point, rays.coherent, rays.incoherent],
            );
        // Compare with the native tree for all rays, and for those with a common end
        let with_ends = native(size, [rays.from_point, rays.to_point, 0.0, 0.0]);
        let candidates = [
            (Structures::Embree, embree_seconds),
            (
                Structures::Native,
                1e-9 * native(
                    size,
                    [rays.from_point, rays.to_point, rays.coherent, rays.incoherent],
                ),
            ),
            (
                Structures::Both,
                1e-9 * (with_ends + embree(size, [0.0, 0.0, rays.coherent, rays.incoherent])),
            ),
        ];
        let (structures, seconds) = match cfg!(feature = "embree") {
            true => candidates.into_iter().fold(
                candidates[0],
                |least, next| if next.1 < least.1 { next } else { least },
            ),
            false => candidates[1],
        };
        Choice {
            structures,
            seconds,
            embree_seconds,
        }
    }
}

/// Prints the choice with its reason.
impl fmt::Display for Choice {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Choice {
            seconds,
            embree_seconds,
            ..
        } = self;
        match self.structures {
            Structures::Embree => write!(f, "embree for all rays: forecast to be the soonest"),
            Structures::Native => write!(
                f,
                "native for all rays: building and tracing is forecast to take {:.2} of Embree's time",
                seconds / embree_seconds
            ),
            Structures::Both => write!(
                f,
                "native for rays with a common end, embree for all others: building both and tracing is forecast to \
                 take {:.2} of Embree's time",
                seconds / embree_seconds
            ),
        }
    }
}

/// Returns the nanoseconds of Embree for rays from a point, to a point, other coherent and incoherent ones.
fn embree(size: SceneSize, counts: [f64; 4]) -> f64 {
    let primitives = size.triangles + size.others;
    EMBREE.start + EMBREE.triangle * primitives + EMBREE.tracing(primitives, counts)
}

/// Returns the nanoseconds of the native backend for the same kinds of rays.
fn native(size: SceneSize, counts: [f64; 4]) -> f64 {
    let SceneSize { triangles, others } = size;
    let mut sum = NATIVE.start + NATIVE.triangle * triangles + NATIVE.tracing(triangles, counts);
    if others > 0.0 {
        let ray = OBJECT_RAY + OBJECT_DOUBLING * others.log2();
        sum += OBJECT_BUILD * others + ray * counts.iter().sum::<f64>();
    }
    sum
}

impl BackendCosts {
    /// Returns the nanoseconds of rays from a point, to a point, other coherent and incoherent ones.
    fn tracing(&self, triangles: f64, counts: [f64; 4]) -> f64 {
        let costs = [self.from_point, self.to_point, self.coherent, self.incoherent];
        let times = costs.iter().zip(counts);
        times
            .map(|(cost, count)| cost.nanoseconds(count, triangles))
            .sum()
    }
}

#[cfg(all(test, feature = "embree"))]
mod tests {
    use super::*;
    use crate::accel::native::testing::baked;
    use crate::mesh::bumpy_sphere;
    use crate::shape::Shape;

    const RAYS: RayForecast = RayForecast {
        from_point: 1e6,
        to_point: 1e6,
        coherent: 0.0,
        incoherent: 0.0,
    };

    #[test]
    fn rays_with_common_ends_go_to_the_native_tree() {
        let choice = Choice::new(&baked(bumpy_sphere(200_000)), &RAYS);
        assert_eq!(choice.structures, Structures::Native);
        assert!(choice.seconds < 0.5 * choice.embree_seconds);
    }

    #[test]
    fn many_coherent_rays_pay_for_a_second_structure() {
        let scene = baked(bumpy_sphere(20_000));
        let rays = |coherent| RayForecast { coherent, ..RAYS };
        assert_eq!(Choice::new(&scene, &rays(1e4)).structures, Structures::Native);
        assert_eq!(Choice::new(&scene, &rays(1e7)).structures, Structures::Both);
    }

    #[test]
    fn shapes_alone_go_to_embree() {
        let mut scene = baked(bumpy_sphere(1000));
        scene.geometries[0] = Geometry::Shape(Shape::Quad);
        let choice = Choice::new(&scene, &RAYS);
        assert_eq!(choice.structures, Structures::Embree);
        assert_eq!(choice.seconds, choice.embree_seconds);
    }
}
