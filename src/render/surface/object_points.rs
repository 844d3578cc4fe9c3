//! Points of sixteen hits in object space, for procedural textures there.

use multiversion::multiversion;

use super::packet::SurfacePacket;
use crate::accel::RayPacket;
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::Instance;
use crate::shading::PatternPacket;

/// Sets the points of the lanes in `mask` in object space, slightly below the surface, because a face of the solid
/// may lie exactly between two cells of a procedural pattern; and the axes of the footprints there,
/// which are given in world space.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(super) fn set_object_points(
    instances: &[Instance],
    (packet, mask): (&RayPacket, &Lanes<bool>),
    ([longer, shorter], points): (&[Lanes3<f64>; 2], &SurfacePacket),
    out: &mut PatternPacket,
) {
    // Copy the mask, of which lanes are removed
    let mut left = *mask;
    // Take the lanes of one transform after the other
    while let Some(first) = left.iter().position(|&is_left| is_left) {
        let number = packet.instance[first];
        let instance = &instances[number as usize];
        let is_moving = instance.is_moving();
        let mut mask = [false; LANES];
        for l in first..LANES {
            let is_same = !is_moving || packet.time[l] == packet.time[first];
            mask[l] = left[l] & (packet.instance[l] == number) & (is_same || l == first);
            left[l] &= !mask[l];
        }
        // Transform their points and footprints by rows of the matrix
        let object_from_world = instance.pose(packet.time[first]).object_from_world();
        let rows = object_from_world.matrix3.transpose();
        for (axis, row) in [rows.x_axis, rows.y_axis, rows.z_axis].into_iter().enumerate() {
            let offset = object_from_world.translation[axis];
            for l in 0..LANES {
                let carved = |axis: usize| {
                    let outward = f64::from(points.ng[axis][l]);
                    let inward = if points.front[l] { -outward } else { outward };
                    points.p[axis][l] + inward * points.error[l]
                };
                let turned = |x: f64, y: f64, z: f64| x * row.x + y * row.y + z * row.z;
                let p = turned(carved(0), carved(1), carved(2)) + offset;
                let [long, short] = [longer, shorter].map(|v| turned(v[0][l], v[1][l], v[2][l]));
                out.p[axis][l] = if mask[l] { p } else { out.p[axis][l] };
                out.axes[0][axis][l] = if mask[l] { long } else { out.axes[0][axis][l] };
                out.axes[1][axis][l] = if mask[l] { short } else { out.axes[1][axis][l] };
            }
        }
    }
}
