//! Forecast of the time that Embree and the native tree take to build and to trace a render's rays.

use std::fmt;

use crate::accel::RayForecast;
use crate::scene::{Geometry, Scene};

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
    to_end: RayCost,
    coherent: RayCost,
    incoherent: RayCost,
}

// Measured on a Xeon with AVX-512 with `whit render --stats -` of `bumpy2m.glb`, and `whit bench` of it and of a mesh of
// 15 000 triangles; incoherent rays with renders of both under an environment map and with interreflection. Only the
// ratios of the backends count.

/// Costs of Embree 3.13.5 at its watertight precision.
const EMBREE: BackendCosts = BackendCosts {
    start: 3e6,
    triangle: 300.0,
    from_point: RayCost {
        ray: 40.0,
        triangle: 100.0,
    },
    to_end: RayCost {
        ray: 80.0,
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
    triangle: 170.0,
    from_point: RayCost {
        ray: 25.0,
        triangle: 50.0,
    },
    to_end: RayCost {
        ray: 40.0,
        triangle: 95.0,
    },
    coherent: RayCost {
        ray: 300.0,
        triangle: 0.0,
    },
    incoherent: RayCost {
        ray: 240.0,
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
pub struct BackendChoice {
    /// Structures with the least time to build them and to trace all rays.
    pub structures: Structures,
    /// Forecast of that time relative to Embree's.
    pub share: f64,
}

impl BackendChoice {
    /// Chooses the structures for a scene and the rays of its render. The choice depends on nothing else, so that images
    /// have the same bits on any machine.
    pub fn new(scene: &Scene, rays: &RayForecast) -> BackendChoice {
        let size = SceneSize::of(scene);
        let embree = size.embree_nanoseconds(rays);
        // Divide the rays into those with a common end and all others
        let with_ends = RayForecast {
            coherent: 0.0,
            incoherent: 0.0,
            ..*rays
        };
        let others = RayForecast {
            from_point: 0.0,
            to_end: 0.0,
            ..*rays
        };
        let both = size.native_nanoseconds(&with_ends) + size.embree_nanoseconds(&others);
        // Take the least
        let native = size.native_nanoseconds(rays);
        let (structures, least) = if !cfg!(feature = "embree") || native < embree.min(both) {
            (Structures::Native, native)
        } else if both < embree {
            (Structures::Both, both)
        } else {
            (Structures::Embree, embree)
        };
        BackendChoice {
            structures,
            share: least / embree,
        }
    }
}

/// Prints the choice with its reason.
impl fmt::Display for BackendChoice {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let share = self.share;
        match self.structures {
            Structures::Embree => write!(f, "embree for all rays: forecast to be the soonest"),
            Structures::Native => write!(
                f,
                "native for all rays: building and tracing is forecast to take {share:.2} of Embree's time"
            ),
            Structures::Both => write!(
                f,
                "native for rays with a common end, embree for all others: building both and tracing is forecast to \
                 take {share:.2} of Embree's time"
            ),
        }
    }
}

impl SceneSize {
    /// Forecasts the time of Embree.
    fn embree_nanoseconds(self, rays: &RayForecast) -> f64 {
        let primitives = self.triangles + self.others;
        EMBREE.start + EMBREE.triangle * primitives + EMBREE.tracing(primitives, rays)
    }

    /// Forecasts the time of the native backend.
    fn native_nanoseconds(self, rays: &RayForecast) -> f64 {
        let SceneSize { triangles, others } = self;
        let trees = NATIVE.start + NATIVE.triangle * triangles + NATIVE.tracing(triangles, rays);
        if others == 0.0 {
            return trees;
        }
        // Add the BSP of all that is no baked triangle
        let ray = OBJECT_RAY + OBJECT_DOUBLING * others.log2();
        let count = rays.from_point + rays.to_end + rays.coherent + rays.incoherent;
        trees + OBJECT_BUILD * others + ray * count
    }
}

impl BackendCosts {
    /// Returns the nanoseconds of all rays in a scene of this many triangles.
    fn tracing(&self, triangles: f64, rays: &RayForecast) -> f64 {
        let time = |cost: RayCost, count| cost.nanoseconds(count, triangles);
        time(self.from_point, rays.from_point)
            + time(self.to_end, rays.to_end)
            + time(self.coherent, rays.coherent)
            + time(self.incoherent, rays.incoherent)
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
        to_end: 1e6,
        coherent: 0.0,
        incoherent: 0.0,
    };

    #[test]
    fn rays_with_common_ends_go_to_the_native_tree() {
        let choice = BackendChoice::new(&baked(bumpy_sphere(200_000)), &RAYS);
        assert_eq!(choice.structures, Structures::Native);
        assert!(choice.share < 0.7);
    }

    #[test]
    fn many_coherent_rays_pay_for_a_second_structure() {
        let scene = baked(bumpy_sphere(20_000));
        let rays = |coherent| RayForecast { coherent, ..RAYS };
        assert_eq!(
            BackendChoice::new(&scene, &rays(1e4)).structures,
            Structures::Native
        );
        assert_eq!(
            BackendChoice::new(&scene, &rays(1e7)).structures,
            Structures::Both
        );
    }

    #[test]
    fn shapes_alone_go_to_embree() {
        let mut scene = baked(bumpy_sphere(1000));
        scene.geometries[0] = Geometry::Shape(Shape::Quad);
        let choice = BackendChoice::new(&scene, &RAYS);
        assert_eq!(choice.structures, Structures::Embree);
        assert_eq!(choice.share, 1.0);
    }
}
