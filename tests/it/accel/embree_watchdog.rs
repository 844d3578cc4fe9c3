//! Every pair of call, flag, kernel and kind of geometry in use comes back.
//!
//! On 3.13.5 a coherent `rtcOccluded16` over Embree's own instances never does, so all calls run under a watchdog.

use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use glam::{DAffine3, DVec3, Vec3};
use whit::accel::embree::EmbreeAccel;
use whit::accel::{Accel, AccelOptions, Coherence, Instancing, Kernel, LANES, Precision, RayPacket};
use whit::buffer::Buffer;
use whit::mesh::Mesh;
use whit::numeric::Ray;
use whit::scene::{Geometry, Instance, Scene};
use whit::shape::{Shape, Sphere};

/// Far longer than any of these takes, far shorter than anyone waits.
const PATIENCE: Duration = Duration::from_secs(20);

#[derive(Clone, Copy, Debug)]
enum Kind {
    Triangles,
    Spheres,
    PlacedMeshes,
    NativeInstances,
    All,
    AllNative,
    Moving,
}

impl Kind {
    fn instancing(self) -> Instancing {
        match self {
            Kind::NativeInstances | Kind::AllNative => Instancing::Native,
            _ => Instancing::Callback,
        }
    }

    /// The kinds of geometry in it: triangles where they are, spheres, placed meshes.
    fn holds(self) -> [bool; 3] {
        match self {
            Kind::Triangles => [true, false, false],
            Kind::Spheres => [false, true, false],
            Kind::PlacedMeshes | Kind::NativeInstances => [false, false, true],
            Kind::All | Kind::AllNative | Kind::Moving => [true; 3],
        }
    }
}

#[derive(Clone, Copy, Debug)]
enum Call {
    Intersect,
    Occluded,
    RawIntersect,
    RawOccluded,
}

/// A tetrahedron around the origin.
fn tetrahedron() -> Geometry {
    Geometry::Mesh(Mesh {
        positions: Buffer::from(vec![
            [1.0, 1.0, 1.0],
            [-1.0, -1.0, 1.0],
            [-1.0, 1.0, -1.0],
            [1.0, -1.0, -1.0],
        ]),
        triangles: Buffer::from(vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
        ..Mesh::default()
    })
}

fn scene(kind: Kind) -> Scene {
    let [triangles, spheres, placed_meshes] = kind.holds();
    let mut instances = Vec::new();
    let mut place = |geometry, map| instances.push(Instance::new("", geometry, 0, map).unwrap());
    if triangles {
        place(0, DAffine3::IDENTITY);
    }
    for i in 0..64 {
        let at = DVec3::new(f64::from(i % 8), f64::from(i / 8), f64::from(i % 3)) * 2.0 - DVec3::splat(7.0);
        let map = DAffine3::from_translation(at) * DAffine3::from_rotation_x(f64::from(i));
        if placed_meshes {
            place(0, map);
        }
        if spheres {
            place(1, map);
        }
    }
    if let Kind::Moving = kind {
        for instance in instances.iter_mut().skip(1).step_by(2) {
            let start = instance.world_from_object();
            let end = DAffine3::from_translation(DVec3::X) * start * DAffine3::from_rotation_y(1.0);
            *instance = Instance::moving("", instance.geometry, 0, [start, end]).unwrap();
        }
    }
    Scene {
        geometries: vec![tetrahedron(), Geometry::Shape(Shape::Sphere(Sphere::UNIT))],
        instances,
        ..Scene::default()
    }
}

/// Packets of rays side by side, and of rays every way.
fn packets() -> Vec<RayPacket> {
    let packet = |i: usize| {
        let mut packet = RayPacket::EMPTY;
        for lane in 0..LANES {
            let n = (i * LANES + lane) as f32;
            let ray = if i.is_multiple_of(2) {
                Ray::new(Vec3::new(n % 32.0 - 16.0, n / 32.0 - 16.0, 20.0), Vec3::NEG_Z)
            } else {
                Ray::new(
                    Vec3::splat(0.5),
                    Vec3::new((n * 1.7).sin(), (n * 2.3).cos(), (n * 0.9).sin()),
                )
            };
            packet.set(
                lane,
                &Ray {
                    time: n % 7.0 / 7.0,
                    ..ray
                },
            );
        }
        packet.drop_untraceable();
        packet
    };
    (0..64).map(packet).collect()
}

#[test]
fn every_call_flag_kernel_and_kind_returns() {
    for kind in [
        Kind::Triangles,
        Kind::Spheres,
        Kind::PlacedMeshes,
        Kind::NativeInstances,
        Kind::All,
        Kind::AllNative,
        Kind::Moving,
    ] {
        for precision in Precision::ALL {
            for kernel in [Kernel::Packet, Kernel::Single] {
                for isa in [None, Some("avx2"), Some("sse2")] {
                    let options = AccelOptions {
                        precision,
                        kernel,
                        instancing: kind.instancing(),
                        isa: isa.map(str::to_owned),
                        ..AccelOptions::default()
                    };
                    let name = format!("{kind:?} {precision:?} {kernel:?} {isa:?}");
                    every_call_and_flag_returns(&name, kind, options);
                }
            }
        }
    }
}

/// Checks that each call with each flag returns, on one structure. It is the structure of a thread of its own, which
/// reports each call that is over.
fn every_call_and_flag_returns(name: &str, kind: Kind, options: AccelOptions<'static>) {
    let (report, reports) = mpsc::channel();
    let caller = thread::spawn(move || {
        let scene = scene(kind);
        // Only an instruction set that the processor lacks is refused.
        let Ok(accel) = EmbreeAccel::build(&scene, &options) else {
            return;
        };
        for call in [
            Call::Intersect,
            Call::Occluded,
            Call::RawIntersect,
            Call::RawOccluded,
        ] {
            for order in [Coherence::Coherent, Coherence::Incoherent] {
                // The report before a call says which one does not return
                report.send((call, order)).unwrap();
                let mut packets = packets();
                match call {
                    Call::Intersect => accel.intersect(&mut packets, order),
                    Call::Occluded => accel.occluded(&mut packets, order),
                    Call::RawIntersect => accel.baseline_intersect16(&mut packets, order),
                    Call::RawOccluded => accel.baseline_occluded16(&mut packets, order),
                }
                let is_hit = |p: &RayPacket| (0..LANES).any(|l| p.hit(l).is_some() || p.is_blocked(l));
                assert!(packets.iter().any(is_hit), "no ray hit anything");
            }
        }
    });
    let mut last = None;
    loop {
        match reports.recv_timeout(PATIENCE) {
            Ok(call) => last = Some(call),
            Err(mpsc::RecvTimeoutError::Timeout) => panic!("{name}, {last:?} did not return"),
            Err(mpsc::RecvTimeoutError::Disconnected) => break,
        }
    }
    assert!(caller.join().is_ok(), "{name}, {last:?} failed");
}
