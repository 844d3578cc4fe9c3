//! Spheres of the world that lie close together, up to four to a primitive of the user geometry.
//!
//! A callback's time goes by being called and by waiting for memory: measured on 10^5 spheres in incoherent order, three
//! fifths of it are one load of a sphere. The four of a cluster are loaded together, and a ray is asked about them once. They
//! are runs along Morton's curve. By the surface area heuristic a box is met as often as its area is large, so a sphere joins
//! a cluster only where the box around both has less area than the two boxes; the others stay primitives of their own.

use glam::DVec3;

use crate::accel::NO_HIT;
use crate::numeric::Bounds;
use crate::numeric::morton::sorted_keys;
use crate::shape::Sphere;

/// Most spheres of a cluster.
pub(super) const MEMBERS: usize = 4;

/// Spheres side by side, in two lines of the cache.
#[derive(Clone, Debug, PartialEq)]
#[repr(C, align(128))]
pub(super) struct SphereCluster {
    /// By axis.
    pub(super) center: [[f64; MEMBERS]; 3],
    /// NaN, which nothing meets, where there is no sphere; these are the last.
    pub(super) radius: [f64; MEMBERS],
}

impl SphereCluster {
    /// Of at most [`MEMBERS`] spheres.
    pub(super) fn of(spheres: &[Sphere]) -> SphereCluster {
        let mut cluster = SphereCluster {
            center: [[0.0; MEMBERS]; 3],
            radius: [f64::NAN; MEMBERS],
        };
        for (member, sphere) in spheres.iter().enumerate() {
            for axis in 0..3 {
                cluster.center[axis][member] = sphere.center[axis];
            }
            cluster.radius[member] = sphere.radius;
        }
        cluster
    }

    /// One of its spheres, if there are so many.
    #[inline(always)]
    pub(super) fn sphere(&self, member: usize) -> Option<Sphere> {
        let radius = self.radius[member];
        let center = DVec3::from_array([0, 1, 2].map(|axis| self.center[axis][member]));
        (!radius.is_nan()).then_some(Sphere { center, radius })
    }

    /// The box around its spheres.
    pub(super) fn bounds(&self) -> Bounds {
        let spheres = (0..MEMBERS).filter_map(|member| self.sphere(member));
        spheres.fold(Bounds::EMPTY, |bounds, sphere| bounds.union(sphere.bounds()))
    }
}

/// Spheres that are asked about together, and those that are not.
#[derive(Debug, Default)]
pub(super) struct Clusters {
    clusters: Vec<SphereCluster>,
    /// The instances that the members of each are; [`NO_HIT`] where there is none.
    instances: Vec<[u32; MEMBERS]>,
}

impl Clusters {
    /// Gathers spheres of the world, each with the number of its instance; the second is who stays alone.
    pub(super) fn of(spheres: &[(u32, Sphere)]) -> (Clusters, Vec<u32>) {
        let (_, keys) = sorted_keys(spheres.len(), |i| spheres[i].1.center);
        let (mut clusters, mut alone) = (Clusters::default(), Vec::new());
        let mut run: Vec<(u32, Sphere)> = Vec::with_capacity(MEMBERS);
        let mut bounds = Bounds::EMPTY;
        for (_, index) in keys {
            let next = spheres[index as usize];
            let own = next.1.bounds();
            let both = bounds.union(own);
            let joins = run.len() < MEMBERS && half_area(&both) <= half_area(&bounds) + half_area(&own);
            if !joins {
                clusters.push(&run, &mut alone);
                run.clear();
            }
            bounds = if joins { both } else { own };
            run.push(next);
        }
        clusters.push(&run, &mut alone);
        (clusters, alone)
    }

    fn push(&mut self, run: &[(u32, Sphere)], alone: &mut Vec<u32>) {
        match run {
            [] => (),
            [one] => alone.push(one.0),
            _ => {
                let spheres: Vec<Sphere> = run.iter().map(|one| one.1).collect();
                let mut instances = [NO_HIT; MEMBERS];
                instances.iter_mut().zip(run).for_each(|(to, one)| *to = one.0);
                self.clusters.push(SphereCluster::of(&spheres));
                self.instances.push(instances);
            }
        }
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.clusters.len()
    }

    /// A cluster, and the instances that its members are.
    #[inline(always)]
    pub(super) fn get(&self, index: usize) -> Option<(&SphereCluster, &[u32; MEMBERS])> {
        // Only the cluster is looked at where nothing is met.
        Some((self.clusters.get(index)?, self.instances.get(index)?))
    }

    /// How many spheres they hold.
    pub(super) fn sphere_count(&self) -> usize {
        self.instances
            .as_flattened()
            .iter()
            .filter(|&&instance| instance != NO_HIT)
            .count()
    }

    /// Bytes on the heap.
    pub(super) fn byte_count(&self) -> u64 {
        (size_of_val(&self.clusters[..]) + size_of_val(&self.instances[..])) as u64
    }
}

/// Half the area of a box; 0 of an empty one.
fn half_area(bounds: &Bounds) -> f64 {
    let [x, y, z] = bounds.extent().to_array();
    x * y + y * z + z * x
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sphere(x: f64, radius: f64) -> Sphere {
        Sphere {
            center: DVec3::new(x, 0.0, 0.0),
            radius,
        }
    }

    #[test]
    fn spheres_that_lie_close_are_asked_about_together_and_the_others_alone() {
        let at = [0.0, 1.0, 2.0, 3.0, 4.0, 100.0, 1000.0, 1001.0];
        let spheres: Vec<(u32, Sphere)> = (10u32..).zip(at.map(|x| sphere(x, 1.0))).collect();
        let (clusters, alone) = Clusters::of(&spheres);
        assert_eq!(clusters.instances, [[10, 11, 12, 13], [16, 17, NO_HIT, NO_HIT]]);
        assert_eq!(alone, [14, 15]);
        assert_eq!((clusters.len(), clusters.sphere_count()), (2, 6));
        let (last, _) = clusters.get(1).unwrap();
        assert_eq!(last.sphere(1), Some(sphere(1001.0, 1.0)));
        assert_eq!(last.sphere(2), None);
        assert_eq!(last.bounds().min, DVec3::new(999.0, -1.0, -1.0));
        assert_eq!(last.bounds().max, DVec3::new(1002.0, 1.0, 1.0));
    }

    #[test]
    fn every_sphere_is_in_one_place() {
        // A large one among small ones, some of them concentric.
        let spheres: Vec<(u32, Sphere)> = (0..1000)
            .map(|i| (i, sphere(f64::from(i % 97), if i == 500 { 50.0 } else { 0.3 })))
            .collect();
        let (clusters, alone) = Clusters::of(&spheres);
        let mut all: Vec<u32> = clusters.instances.as_flattened().to_vec();
        all.retain(|&instance| instance != NO_HIT);
        assert_eq!(all.len(), clusters.sphere_count());
        all.extend(alone);
        all.sort_unstable();
        assert!(all.into_iter().eq(0..1000));
    }

    #[test]
    fn no_spheres_make_no_clusters() {
        let (clusters, alone) = Clusters::of(&[]);
        assert_eq!((clusters.len(), alone.len()), (0, 0));
    }
}
