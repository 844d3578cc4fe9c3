//! Clusters of up to eight points of a cloud, each one primitive of the user geometry.
//!
//! A cluster stores its centres in object space, so that all instances of a cloud share its clusters. They become spheres
//! of a [`SphereCluster`] in a callback and are tested as those are. The gain over single points is that of the clusters
//! of spheres; besides, Embree's build takes far less memory.

use std::sync::Arc;

use glam::{DVec3, Vec3A};

use super::sphere_cluster::{COST, MEMBERS, SphereCluster};
use crate::accel::NO_HIT;
use crate::accel::clusters::Clusters;
use crate::accel::morton::Box4;
use crate::accel::shape_query::world_sphere;
use crate::mesh::PointCloud;
use crate::numeric::Bounds;
use crate::parallel;
use crate::scene::{Geometry, Instance, Scene};

/// Eight points as structure of arrays, in two cache lines.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub(super) struct PointCluster {
    /// Coordinates of the centres in object space, by axis.
    center: [[f32; MEMBERS]; 3],
    /// Index of each point in its cloud; [`NO_HIT`] in unused slots, which are the last.
    points: [u32; MEMBERS],
}

impl PointCluster {
    fn of(cloud: &PointCloud, members: &[u32]) -> PointCluster {
        let mut cluster = PointCluster {
            center: [[0.0; MEMBERS]; 3],
            points: [NO_HIT; MEMBERS],
        };
        for (member, &point) in members.iter().enumerate() {
            for axis in 0..3 {
                cluster.center[axis][member] = cloud.positions[point as usize][axis];
            }
            cluster.points[member] = point;
        }
        cluster
    }
}

/// Clusters of all points of a cloud.
type CloudClusters = Arc<[PointCluster]>;

/// Groups nearby points of a cloud by the surface area heuristic.
fn clustered(cloud: &PointCloud) -> CloudClusters {
    let Bounds { min, max } = cloud.bounds();
    let around = Box4 {
        low: Vec3A::from(min.as_vec3()),
        high: Vec3A::from(max.as_vec3()),
    };
    let reach = Vec3A::splat(cloud.radius as f32);
    let bounds = |point: usize| {
        let center = Vec3A::from(cloud.positions[point]);
        Box4 {
            low: center - reach,
            high: center + reach,
        }
    };
    let found = Clusters::of(cloud.len(), &around, bounds, &COST);
    // Copy the centres, part by part in parallel
    let parts = parallel::map(found.parts().len(), &|part| {
        let clusters = found.parts()[part].iter();
        clusters
            .map(|members| PointCluster::of(cloud, members))
            .collect::<Vec<_>>()
    });
    parts.into_iter().flatten().collect()
}

/// Clusters of all clouds that have instances, by geometry.
pub(super) struct ClusteredClouds(Vec<Option<CloudClusters>>);

impl ClusteredClouds {
    /// Clusters the points of the scene's clouds, each cloud once.
    pub(super) fn of(scene: &Scene) -> ClusteredClouds {
        let mut is_used = vec![false; scene.geometries.len()];
        for instance in &scene.instances {
            is_used[instance.geometry as usize] = true;
        }
        let clouds = scene.geometries.iter().zip(is_used).map(|(geometry, is_used)| {
            let cloud = geometry.point_cloud().filter(|_| is_used)?;
            Some(clustered(cloud))
        });
        ClusteredClouds(clouds.collect())
    }
}

/// Numbers of the point clusters of all instanced clouds.
#[derive(Default)]
pub(super) struct PointClusters<'s> {
    runs: Vec<PointRun<'s>>,
    cluster_count: usize,
    point_count: usize,
}

/// Range of consecutive numbers that belong to one instance of a cloud.
struct PointRun<'s> {
    first: usize,
    index: u32,
    instance: &'s Instance,
    cloud: &'s PointCloud,
    clusters: CloudClusters,
}

/// Choice between static and moving instances.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Motion {
    /// Instances that are at rest.
    Static,
    /// Instances that move while the shutter is open.
    Moving,
}

/// One cluster of an instanced cloud.
#[derive(Clone, Copy)]
pub(super) struct PlacedPoints<'a> {
    /// Index of the instance in [`Scene::instances`].
    pub(super) index: u32,
    /// Instance that places the cloud in the world.
    pub(super) instance: &'a Instance,
    /// Cloud that the points belong to.
    pub(super) cloud: &'a PointCloud,
    cluster: &'a PointCluster,
}

impl<'s> PointClusters<'s> {
    /// Numbers the clusters of the instances that move, or of those that are static.
    pub(super) fn of(scene: &'s Scene, clouds: &ClusteredClouds, motion: Motion) -> PointClusters<'s> {
        let mut numbered = PointClusters::default();
        for (index, instance) in (0u32..).zip(&scene.instances) {
            let geometry = &scene.geometries[instance.geometry as usize];
            let clusters = &clouds.0[instance.geometry as usize];
            // Skip other geometries, and instances of the other kind
            let (Geometry::Points(cloud), Some(clusters)) = (geometry, clusters) else {
                continue;
            };
            if instance.is_moving() != (motion == Motion::Moving) || clusters.is_empty() {
                continue;
            }
            numbered.runs.push(PointRun {
                first: numbered.cluster_count,
                index,
                instance,
                cloud,
                clusters: clusters.clone(),
            });
            numbered.cluster_count += clusters.len();
            numbered.point_count += cloud.len();
        }
        numbered
    }

    /// Returns the instances of the clouds.
    pub(super) fn instances(&self) -> impl Iterator<Item = &'s Instance> {
        self.runs.iter().map(|run| run.instance)
    }

    /// Returns the number of clusters.
    pub(super) fn len(&self) -> usize {
        self.cluster_count
    }

    /// Returns the number of points in all clusters.
    pub(super) fn point_count(&self) -> usize {
        self.point_count
    }

    /// Returns a cluster by its number.
    #[inline(always)]
    pub(super) fn get(&self, number: usize) -> Option<PlacedPoints<'_>> {
        let run = match self.runs.as_slice() {
            [only] => only,
            runs => runs.get(runs.partition_point(|run| run.first <= number).checked_sub(1)?)?,
        };
        Some(PlacedPoints {
            index: run.index,
            instance: run.instance,
            cloud: run.cloud,
            cluster: run.clusters.get(number - run.first)?,
        })
    }

    /// Returns the number of bytes on the heap; instances of one cloud share its clusters.
    pub(super) fn byte_count(&self) -> u64 {
        let mut shared: Vec<&CloudClusters> = self.runs.iter().map(|run| &run.clusters).collect();
        shared.sort_unstable_by_key(|clusters| clusters.as_ptr());
        shared.dedup_by_key(|clusters| clusters.as_ptr());
        let clusters: usize = shared
            .into_iter()
            .map(|clusters| size_of_val(&clusters[..]))
            .sum();
        (clusters + size_of_val(&self.runs[..])) as u64
    }
}

impl<'a> PlacedPoints<'a> {
    /// Returns the indices of the points in their cloud, with [`NO_HIT`] in unused slots.
    pub(super) fn slots(&self) -> &'a [u32; MEMBERS] {
        &self.cluster.points
    }

    /// Returns the indices of the points in their cloud.
    pub(super) fn points(&self) -> impl Iterator<Item = u32> + use<'a> {
        self.cluster
            .points
            .iter()
            .copied()
            .take_while(|&point| point != NO_HIT)
    }

    /// Returns the points as spheres in world space; `None` unless the transform keeps them spheres without a rotation, and
    /// does not move.
    #[inline(always)]
    pub(super) fn world_spheres(&self) -> Option<SphereCluster> {
        let pose = self.instance.pose(0.0);
        if self.instance.is_moving() {
            return None;
        }
        let mut spheres = SphereCluster::EMPTY;
        for member in 0..MEMBERS {
            if self.cluster.points[member] == NO_HIT {
                break;
            }
            let center = [0, 1, 2].map(|axis| f64::from(self.cluster.center[axis][member]));
            let sphere = world_sphere(&pose, &self.cloud.sphere_at(DVec3::from_array(center)))?;
            spheres.set(member, &sphere);
        }
        Some(spheres)
    }

    /// Returns the world-space box of the points at all times.
    pub(super) fn world_bounds(&self) -> Bounds {
        let boxes = self
            .points()
            .map(|point| self.instance.point_bounds(self.cloud, point));
        boxes.fold(Bounds::EMPTY, Bounds::union)
    }

    /// Returns the world-space box of the points after `step` of `step_count` steps, as [`Instance::step_bounds`] defines
    /// it.
    pub(super) fn step_bounds(&self, step: u32, step_count: u32) -> Bounds {
        let boxes = self.points().map(|point| {
            let sphere = Geometry::Shape(self.cloud.shape(point));
            let steps = [step, step_count];
            self.instance.step_bounds(&sphere, &sphere.bounds(), steps)
        });
        boxes.fold(Bounds::EMPTY, Bounds::union)
    }
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;

    use super::*;

    fn cloud(count: usize) -> PointCloud {
        let at = |i: usize| [(i % 7) as f32, (i % 5) as f32, (i / 11) as f32];
        PointCloud {
            positions: (0..count).map(at).collect::<Vec<_>>().into(),
            radius: 0.25,
            colors: None,
        }
    }

    #[test]
    fn clusters_of_two_clouds_are_numbered_one_after_the_other() {
        let instance = |geometry| Instance::new("", geometry, 0, DAffine3::IDENTITY).unwrap();
        let scene = Scene {
            geometries: [20, 0, 3].map(|count| Geometry::Points(cloud(count))).to_vec(),
            instances: [0, 1, 2, 0].map(instance).to_vec(),
            ..Scene::default()
        };
        let clouds = ClusteredClouds::of(&scene);
        let clusters = PointClusters::of(&scene, &clouds, Motion::Static);
        let mut found: Vec<[u32; 2]> = (0..clusters.len() + 2)
            .filter_map(|number| clusters.get(number))
            .flat_map(|at| at.points().map(move |point| [at.index, point]))
            .collect();
        found.sort_unstable();
        let all = [(0u32, 20u32), (2, 3), (3, 20)];
        let expected = all.map(|(index, count)| (0..count).map(move |point| [index, point]));
        assert!(found.into_iter().eq(expected.into_iter().flatten()));
        assert_eq!(clusters.point_count(), 43);
        assert_eq!(PointClusters::of(&scene, &clouds, Motion::Moving).len(), 0);
    }

    #[test]
    fn point_cluster_takes_two_cache_lines() {
        assert_eq!(size_of::<PointCluster>(), 128);
    }
}
