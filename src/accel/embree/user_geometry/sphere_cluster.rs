//! Clusters of up to eight world-space spheres, each one primitive of the user geometry.
//!
//! A callback spends its time on the call and on memory latency, and Embree on the traversal down to it: eight times
//! fewer primitives make a tree that is a level lower and eight times smaller, and the spheres of a cluster are loaded
//! together. Clusters are numbered in the order of a tree, as their boxes will be in Embree's.

use glam::{DVec3, Vec3A};

use crate::accel::NO_HIT;
use crate::accel::clusters::{self, Cost};
use crate::accel::morton::Box4;
use crate::numeric::Bounds;
use crate::shape::Sphere;

/// Maximum number of spheres in a cluster.
pub(super) const MEMBERS: usize = 8;
/// Cost model of clusters of spheres: traversal to a cluster and its callback, one further sphere in the test, and one
/// further node. A ray is tested against all eight in a few vectors, so eight spheres per callback are best nearly
/// everywhere (by `cargo bench --bench timing -- spheres` anything from 0 to 0.15 for a member is within the noise).
pub(super) const COST: Cost = Cost {
    limit: MEMBERS as u32,
    visit: 1.0,
    member: 0.05,
    split: 1.0,
    whole_limit: u32::MAX,
};
/// Least number of spheres in a cluster; fewer would take more memory than as primitives of their own.
const MIN_MEMBERS: usize = 3;

/// Eight spheres as structure of arrays, in four cache lines.
#[derive(Clone, Debug, PartialEq)]
#[repr(C, align(64))]
pub(super) struct SphereCluster {
    /// Coordinates of the centres, by axis.
    pub(super) center: [[f64; MEMBERS]; 3],
    /// Radii; NaN, which no ray hits, in unused slots, which are the last.
    pub(super) radius: [f64; MEMBERS],
}

impl SphereCluster {
    /// Cluster that has no spheres.
    pub(super) const EMPTY: SphereCluster = SphereCluster {
        center: [[0.0; MEMBERS]; 3],
        radius: [f64::NAN; MEMBERS],
    };

    /// Packs at most [`MEMBERS`] spheres.
    fn of(spheres: impl Iterator<Item = Sphere>) -> SphereCluster {
        let mut cluster = SphereCluster::EMPTY;
        for (member, sphere) in spheres.enumerate() {
            cluster.set(member, &sphere);
        }
        cluster
    }

    /// Sets one of the spheres; those before it must be set, too.
    #[inline(always)]
    pub(super) fn set(&mut self, member: usize, sphere: &Sphere) {
        for axis in 0..3 {
            self.center[axis][member] = sphere.center[axis];
        }
        self.radius[member] = sphere.radius;
    }

    /// Returns one of the spheres, or `None` for an unused slot.
    #[inline(always)]
    pub(super) fn sphere(&self, member: usize) -> Option<Sphere> {
        let radius = self.radius[member];
        let center = DVec3::from_array([0, 1, 2].map(|axis| self.center[axis][member]));
        (!radius.is_nan()).then_some(Sphere { center, radius })
    }

    /// Returns the bounding box of the spheres.
    pub(super) fn bounds(&self) -> Bounds {
        let spheres = (0..MEMBERS).filter_map(|member| self.sphere(member));
        spheres.fold(Bounds::EMPTY, |bounds, sphere| bounds.union(sphere.bounds()))
    }
}

/// A cluster of spheres with the numbers of its members.
#[derive(Clone, Copy)]
pub(super) struct NumberedSpheres<'a> {
    /// Spheres in world space.
    pub(super) cluster: &'a SphereCluster,
    /// Instance index of each member; any in unused slots.
    pub(super) instances: &'a [u32; MEMBERS],
    /// Index of each member in its instance; any in unused slots.
    pub(super) primitives: &'a [u32; MEMBERS],
}

/// All sphere clusters of a scene.
#[derive(Debug, Default)]
pub(super) struct SphereClusters {
    clusters: Vec<SphereCluster>,
    /// Instance index of each member; [`NO_HIT`] in unused slots.
    instances: Vec<[u32; MEMBERS]>,
}

impl SphereClusters {
    /// Clusters world-space spheres, each with its instance index; also returns the instances that stay unclustered.
    pub(super) fn of(spheres: &[(u32, Sphere)]) -> (SphereClusters, Vec<u32>) {
        let bounds = |i: usize| {
            let Bounds { min, max } = spheres[i].1.bounds();
            let [low, high] = [min, max].map(|corner| Vec3A::from(corner.as_vec3()));
            Box4 { low, high }
        };
        let mut around = Box4::EMPTY;
        (0..spheres.len()).for_each(|i| around.add(&bounds(i)));
        // Group nearby spheres by the surface area heuristic
        let found = clusters::Clusters::of(spheres.len(), &around, bounds, &COST);
        let mut unclustered = Vec::new();
        let mut clusters = SphereClusters {
            clusters: Vec::with_capacity(found.len()),
            instances: Vec::with_capacity(found.len()),
        };
        for members in found.iter() {
            let members = members.iter().map(|&i| spheres[i as usize]);
            // Leave small clusters as single primitives
            if members.len() < MIN_MEMBERS {
                unclustered.extend(members.map(|(instance, _)| instance));
                continue;
            }
            // Store the instances and pack the spheres
            let mut instances = [NO_HIT; MEMBERS];
            for (to, (instance, _)) in instances.iter_mut().zip(members.clone()) {
                *to = instance;
            }
            clusters.instances.push(instances);
            clusters
                .clusters
                .push(SphereCluster::of(members.map(|(_, sphere)| sphere)));
        }
        (clusters, unclustered)
    }

    /// Returns the number of clusters.
    pub(super) fn len(&self) -> usize {
        self.clusters.len()
    }

    /// Returns a cluster with the numbers of its members.
    #[inline(always)]
    pub(super) fn get(&self, index: usize) -> Option<NumberedSpheres<'_>> {
        Some(NumberedSpheres {
            cluster: self.clusters.get(index)?,
            // The instance indices are in an array of their own, as they are read only for hits.
            instances: self.instances.get(index)?,
            // A sphere has one part
            primitives: &[0; MEMBERS],
        })
    }

    /// Returns the number of spheres in all clusters.
    pub(super) fn sphere_count(&self) -> usize {
        let instances = self.instances.as_flattened().iter();
        instances.filter(|&&instance| instance != NO_HIT).count()
    }

    /// Returns the number of bytes on the heap.
    pub(super) fn byte_count(&self) -> u64 {
        (size_of_val(&self.clusters[..]) + size_of_val(&self.instances[..])) as u64
    }
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
    fn close_spheres_are_clustered_and_distant_ones_single() {
        let far = 1e6;
        let at = [0.0, 1.0, 2.0, far, 2e5, far + 1.0, far + 2.0, far + 3.0];
        let spheres: Vec<(u32, Sphere)> = (10u32..).zip(at.map(|x| sphere(x, 1.0))).collect();
        let (clusters, unclustered) = SphereClusters::of(&spheres);
        let none = NO_HIT;
        assert_eq!(
            clusters.instances,
            [
                [10, 11, 12, none, none, none, none, none],
                [13, 15, 16, 17, none, none, none, none]
            ]
        );
        assert_eq!(unclustered, [14]);
        assert_eq!((clusters.len(), clusters.sphere_count()), (2, 7));
        let last = clusters.get(1).unwrap().cluster;
        assert_eq!(last.sphere(1), Some(sphere(far + 1.0, 1.0)));
        assert_eq!(last.sphere(4), None);
        assert_eq!(last.bounds().min, DVec3::new(far - 1.0, -1.0, -1.0));
        assert_eq!(last.bounds().max, DVec3::new(far + 4.0, 1.0, 1.0));
    }

    #[test]
    fn every_sphere_is_in_exactly_one_cluster_or_single() {
        // One large sphere among small ones, some of them concentric.
        let spheres: Vec<(u32, Sphere)> = (0..1000)
            .map(|i| (i, sphere(f64::from(i % 97), if i == 500 { 50.0 } else { 0.3 })))
            .collect();
        let (clusters, unclustered) = SphereClusters::of(&spheres);
        let mut all: Vec<u32> = clusters.instances.as_flattened().to_vec();
        all.retain(|&instance| instance != NO_HIT);
        assert_eq!(all.len(), clusters.sphere_count());
        all.extend(unclustered);
        all.sort_unstable();
        assert!(all.into_iter().eq(0..1000));
    }

    #[test]
    fn no_spheres_make_no_clusters() {
        let (clusters, unclustered) = SphereClusters::of(&[]);
        assert_eq!((clusters.len(), unclustered.len()), (0, 0));
    }
}
