//! Seams between instances of one tile: each instance transforms rays into its object space and rounds them there.

use glam::{DAffine3, DVec3};

use crate::accel::{AccelError, Hit};
use crate::numeric::{DoubleDouble, Ray, SplitMix64};
use crate::scene::{Geometry, Instance, Scene};
use crate::verify::harness::test_meshes::{mesh, scene};
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts, Watertightness, towards};

pub(in crate::verify::cases) const CASES: &[Case] = &[Case {
    id: "H47",
    title: "seams of instances",
    construction: "ground of 8 by 8 instances of a tile, 1 to 10^6 from the origin, with and without real gaps, and rays at its seams",
    oracle: "the tiles' edges in world space to 106 bits: a ray through a gap misses, every other ray hits the tile \
        below it",
    bound: "no leak, and no hit in a gap beyond the derived rounding bound of rays transformed to object space",
    unit: "of the bound",
    required: Watertightness::Edges,
    run: seams,
    ..Case::TRIANGLES
}];

/// Number of tiles along each axis.
const TILES: usize = 8;
/// Decimal exponents of the distance from the origin.
const DISTANCES: std::ops::RangeInclusive<i32> = 0..=6;
/// Distances between neighbouring tiles. The width of a tile is the f32 nearest to the distance: exactly 1; too narrow
/// by 1.2e-8; too wide by as much.
const STEPS: [f64; 3] = [1.0, 0.7, 0.3];

/// Distance by which a ray may seem to pass an edge, in roundings of 2^-24 of a tile's farthest vertex: 2 for the ray's
/// origin and direction in object space, 10 for each of two vertices in the sheared frame of the watertight test, 4 for
/// an edge function, and the larger of that and the 28 of a triple product (see the comparison of backends); doubled,
/// as the origin is as far away as the vertex.
const ROUNDINGS: f64 = 64.0;

/// Tiled ground in the plane y = 0.
struct Ground {
    /// Coordinates at which tiles begin, along x and along z.
    starts: Vec<f64>,
    /// Width of a tile along both axes.
    width: f32,
    scene: Scene,
}

impl Ground {
    fn new(distance: f64, step: f64) -> Ground {
        // Build one square tile
        let width = step as f32;
        let side = f64::from(width);
        let at = |x: f64, z: f64| DVec3::new(x, 0.0, z);
        let corners = [at(0.0, 0.0), at(0.0, side), at(side, side), at(side, 0.0)];
        let mut scene = scene(vec![Geometry::Mesh(mesh(&corners, vec![[0, 1, 2], [0, 2, 3]]))]);
        // Instance it on a grid
        let starts: Vec<f64> = (0..TILES).map(|i| distance + i as f64 * step).collect();
        let places = starts.iter().flat_map(|&z| starts.iter().map(move |&x| at(x, z)));
        scene.instances = places
            .filter_map(|place| Instance::new("", 0, 0, DAffine3::from_translation(place)).ok())
            .collect();
        Ground { starts, width, scene }
    }

    /// Returns a ray downward at a seam, near one, or at the border of the ground.
    fn ray(&self, random: &mut SplitMix64) -> Ray {
        let step = f64::from(self.width);
        // Choose a coordinate at a seam or inside a tile
        let mut coordinate = |is_seam: bool| {
            let start = self.starts[random.below(TILES)];
            let beside = random.choose(&[0.0, 1e-7, 1e-4]) * random.within(-1.0, 1.0);
            match is_seam {
                true => start + step * random.choose(&[0.0, 1.0]) + beside,
                false => start + step * random.unit(),
            }
        };
        // Choose a target with one coordinate at a seam
        let (along_x, along_z) = (coordinate(true), coordinate(false));
        let (x, z) = random.choose(&[(along_x, along_z), (along_z, along_x)]);
        let target = DVec3::new(x, 0.0, z);
        let aside = DVec3::new(random.within(-1.0, 1.0), 1.0, random.within(-1.0, 1.0));
        towards(target + random.within(0.5, 4.0) * aside, target)
    }

    /// Returns the distance of a coordinate inside the nearest tile; negative in gaps and outside.
    fn inside(&self, x: DoubleDouble) -> f64 {
        // Computed in double-double precision, because tile and gap differ by 1.2e-8
        let inside_of = |&start: &f64| {
            let left = x - DoubleDouble::of(start);
            let right = DoubleDouble::of(self.width.into()) - left;
            left.nearest().min(right.nearest())
        };
        self.starts
            .iter()
            .map(inside_of)
            .fold(f64::NEG_INFINITY, f64::max)
    }

    fn judge(&self, ray: &Ray, hit: Option<Hit>, tally: &mut Counts) -> Correctness {
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        // A ray that does not point down hits nothing
        if !(d.y < 0.0) {
            return Correctness::wrong_if(hit.is_some());
        }
        // Intersect the ray with the plane in double-double precision
        let t = DoubleDouble::of(-o.y) / DoubleDouble::of(d.y);
        let at = |axis: usize| DoubleDouble::of(o[axis]) + t * DoubleDouble::of(d[axis]);
        let inside = self.inside(at(0)).min(self.inside(at(2)));
        if hit.is_some() == (inside >= 0.0) {
            return Correctness::Right;
        }
        // Scale the bound by the distance of a tile's farthest vertex from the ray, and by how much faster the ray
        // moves along the ground than down
        let reach = 2.0 * f64::from(self.width) + t.nearest() * d.abs().max_element();
        let slant = 1.0 + d.x.abs().max(d.z.abs()) / d.y.abs();
        let bound = ROUNDINGS / f64::from(1 << 24) * reach * slant;
        // Compare the distance from the seam with the bound
        tally.record_error(inside.abs() / bound);
        Correctness::tie_if(inside.abs() <= bound)
    }
}

fn seams(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let grounds: Vec<Ground> = DISTANCES
        .flat_map(|power| STEPS.map(|step| Ground::new(10f64.powi(power), step)))
        .collect();
    trial.over_parts(grounds.len(), &|number, trial| {
        let ground = &grounds[number];
        let engine = trial.engine(&ground.scene)?;
        Ok(
            trial.nearest(&engine, &|random| ground.ray(random), &|ray, hit, tally| {
                ground.judge(ray, hit, tally)
            }),
        )
    })
}
