//! What a ray has met, made ready to be shaded: normals, texture values, the glTF lobe.

use std::f64::consts::{PI, TAU};

use glam::{DAffine3, DVec3};
use whit::mesh::Mesh;
use whit::scene::{
    Filter, Geometry, Image, Instance, Material, Model, Parameter, Scene, Texels, Texture, TextureUse, Wrap,
};
use whit::shape;

use super::approx::{Approx, Approx3, ROUNDING};
use super::hits::{Decision, Doubt, Found, Ray, World, corners, transform_point, transform_vector};

/// Roughness up to which a surface is a mirror.
const MIRROR_ROUGHNESS: f32 = 0.1;

/// A point of a surface as seen along a ray, in world space.
pub struct Surface {
    /// The point.
    pub p: Approx3,
    /// Where rays that leave it may start: the same point, with the distance by which a program steps off a surface
    /// as its error.
    pub start: Approx3,
    /// Geometric normal, on the side that is seen.
    pub ng: Approx3,
    /// Shading normal.
    pub ns: Approx3,
    /// To the viewer.
    pub wo: Approx3,
    pub emission: Approx3,
    /// Diffuse albedo.
    pub c_diff: Approx3,
    /// Reflectance at normal incidence.
    pub f0: Approx3,
    /// The square of the roughness.
    pub alpha: Approx,
    pub is_mirror: bool,
}

impl Surface {
    pub fn new(world: &World, ray: &Ray, found: &Found, doubt: &mut Doubt) -> Surface {
        let scene = world.scene;
        let instance = &scene.instances[found.instance as usize];
        let place = Place {
            instance,
            object_from_world: &world.object_from_world[found.instance as usize],
            wo: -ray.direction.normalize(),
        };
        let (shape, inputs) = match &scene.geometries[instance.geometry as usize] {
            Geometry::Mesh(mesh) => (
                place.on_triangle(mesh, found, doubt),
                Inputs::of_mesh(mesh, found),
            ),
            Geometry::Shape(shape::Shape::Sphere(sphere)) => {
                let p = transform_point(place.object_from_world, ray.origin + ray.direction * found.t);
                let outward = p - Approx3::exact(sphere.center);
                (place.on_sphere(p, outward, doubt), Inputs::of_sphere(outward))
            }
            Geometry::Shape(_) => unreachable!("of shapes, the referee knows spheres"),
        };
        shape.shaded_as(scene, instance, &inputs, doubt)
    }
}

/// The geometric half of a [`Surface`].
struct Shape {
    p: Approx3,
    start: Approx3,
    ng: Approx3,
    ns: Approx3,
    wo: Approx3,
}

/// Where an object stands and from where it is seen.
struct Place<'a> {
    instance: &'a Instance,
    object_from_world: &'a DAffine3,
    wo: Approx3,
}

impl Place<'_> {
    fn on_triangle(&self, mesh: &Mesh, found: &Found, doubt: &mut Doubt) -> Shape {
        let map = &self.instance.world_from_object();
        let [v0, v1, v2] = corners(mesh, found.primitive);
        let p = Approx3::exact(v0) + Approx3::exact(v1 - v0) * found.u + Approx3::exact(v2 - v0) * found.v;
        let [e1, e2] = [v1 - v0, v2 - v0].map(|e| Approx3::rounded(map.transform_vector3(e)));
        let ng = facing(e1.cross(e2).normalize(), self.wo, doubt);
        let size =
            [v0, v1, v2].iter().fold(DVec3::ZERO, |m, v| m.max(v.abs())) + (v1 - v0).abs() + (v2 - v0).abs();
        let mut ns = self.interpolated_normal(mesh, found, ng, doubt).unwrap_or(ng);
        let seen = ns.dot(self.wo);
        doubt.note(Decision::Facing, seen.slack());
        if seen.value <= 0.0 {
            ns = ng;
        }
        self.shape(p, size, ng, ns)
    }

    fn on_sphere(&self, p: Approx3, outward: Approx3, doubt: &mut Doubt) -> Shape {
        let n = self.transform_normal(outward);
        let ng = facing(n, self.wo, doubt);
        self.shape(p, p.value().abs(), ng, ng)
    }

    /// The parts put together; `size` is the largest coordinate that took part in finding `p`, in object space.
    fn shape(&self, p: Approx3, size: DVec3, ng: Approx3, ns: Approx3) -> Shape {
        // A step off the surface is a few roundings of the coordinates and of the triangle's extent.
        let step = DVec3::splat(8.0 * ROUNDING * size.max_element());
        let map = &self.instance.world_from_object();
        let (p, start) = if *map == DAffine3::IDENTITY {
            (p, p.widened(step))
        } else {
            let world = transform_point(map, p);
            let back = transform_point(self.object_from_world, world);
            let there_and_back = transform_point(map, back.widened(step)).error() - world.error();
            (world, world.widened(2.0 * there_and_back.max(DVec3::ZERO)))
        };
        Shape {
            p,
            start,
            ng,
            ns,
            wo: self.wo,
        }
    }

    fn interpolated_normal(
        &self,
        mesh: &Mesh,
        found: &Found,
        ng: Approx3,
        doubt: &mut Doubt,
    ) -> Option<Approx3> {
        let normals = mesh.normals.as_ref()?;
        let corner = |v: u32| Approx3::exact_f32(normals[v as usize]);
        let n = interpolate(mesh, found, corner);
        let usable = n.value().is_finite() && n.value() != DVec3::ZERO;
        let n = usable.then(|| self.transform_normal(n))?;
        Some(facing(n, ng, doubt))
    }

    /// A normal is perpendicular to its surface before and after: it goes by the transposed inverse.
    fn transform_normal(&self, n: Approx3) -> Approx3 {
        transform_vector(&self.object_from_world.matrix3.transpose(), n.normalize()).normalize()
    }
}

/// `n` or its opposite, whichever is on the side of `toward`.
fn facing(n: Approx3, toward: Approx3, doubt: &mut Doubt) -> Approx3 {
    let side = n.dot(toward);
    doubt.note(Decision::Facing, side.slack());
    if side.value < 0.0 { -n } else { n }
}

/// The barycentric mean of what the triangle's corners have.
fn interpolate(mesh: &Mesh, found: &Found, corner: impl Fn(u32) -> Approx3) -> Approx3 {
    let [a, b, c] = mesh.triangles[found.primitive as usize].map(corner);
    // By differences, so that doubt about the weights counts only as far as the corners differ; and the roundings of
    // a weighted sum, which is what others may compute.
    let largest = a.value().abs().max(b.value().abs()).max(c.value().abs());
    (a + (b - a) * found.u + (c - a) * found.v).widened(4.0 * ROUNDING * largest)
}

/// What a mesh brings to the material.
struct Inputs<'a> {
    color: Approx3,
    tex_coord: Box<dyn Fn(u32) -> [Approx; 2] + 'a>,
}

impl<'a> Inputs<'a> {
    fn of_mesh(mesh: &'a Mesh, found: &'a Found) -> Inputs<'a> {
        let color = mesh.colors.as_ref().map_or(Approx3::ONE, |colors| {
            let rgb = |v: u32| {
                let [r, g, b, _] = colors[v as usize];
                Approx3::exact_f32([r, g, b])
            };
            interpolate(mesh, found, rgb)
        });
        let tex_coord = move |set: u32| {
            mesh.tex_coords
                .get(set as usize)
                .map_or([Approx::ZERO; 2], |coords| {
                    let uv = |v: u32| {
                        let [u, v] = coords[v as usize];
                        Approx3::exact_f32([u, v, 0.0])
                    };
                    let uv = interpolate(mesh, found, uv);
                    [uv.x, uv.y]
                })
        };
        Inputs {
            color,
            tex_coord: Box::new(tex_coord),
        }
    }

    /// Longitude from +x towards +y over the whole turn, latitude from the south pole over half of it.
    fn of_sphere(outward: Approx3) -> Inputs<'a> {
        let [x, y, z] = outward.to_array();
        let angle = y.atan2(x) / Approx::rounded(TAU);
        let longitude = if angle.value < 0.0 {
            angle + Approx::ONE
        } else {
            angle
        };
        let latitude = (x.squared() + y.squared()).sqrt().atan2(-z) / Approx::rounded(PI);
        Inputs {
            color: Approx3::ONE,
            tex_coord: Box::new(move |_| [longitude, latitude]),
        }
    }

    fn lookup(
        &self,
        scene: &Scene,
        texture: Option<TextureUse>,
        decode: fn(u8) -> f64,
        doubt: &mut Doubt,
    ) -> Approx3 {
        texture.map_or(Approx3::ONE, |used| {
            let Texture::Image { image, sampler } = scene.textures[used.texture as usize] else {
                unreachable!("the scenes' textures are images")
            };
            let image = &scene.images[image as usize];
            let [u, v] = (self.tex_coord)(used.tex_coord);
            let across = Axis {
                at: u * f64::from(image.width),
                count: i64::from(image.width),
                wrap: sampler.wrap_u,
            };
            let down = Axis {
                at: v * f64::from(image.height),
                count: i64::from(image.height),
                wrap: sampler.wrap_v,
            };
            let texel = |i: i64, j: i64| decoded(image, across.wrapped(i), down.wrapped(j), decode);
            match sampler.filter {
                Filter::Nearest => texel(across.cell(0.0, doubt).0, down.cell(0.0, doubt).0),
                Filter::Linear | Filter::Mipmap => {
                    let (i, x) = across.cell(0.5, doubt);
                    let (j, y) = down.cell(0.5, doubt);
                    let mix = |a: Approx3, b: Approx3, w: Approx| a * (1.0 - w) + b * w;
                    let top = mix(texel(i, j), texel(i + 1, j), x);
                    let bottom = mix(texel(i, j + 1), texel(i + 1, j + 1), x);
                    mix(top, bottom, y)
                }
            }
        })
    }
}

/// A coordinate of a texture, in texels.
struct Axis {
    at: Approx,
    count: i64,
    wrap: Wrap,
}

impl Axis {
    /// The cell of unit length that the coordinate lies in, the first of which starts at `offset`, and where in it.
    fn cell(&self, offset: f64, doubt: &mut Doubt) -> (i64, Approx) {
        let at = self.at - Approx::exact(offset);
        let index = at.value.floor();
        let within = at - Approx::exact(index);
        doubt.note(Decision::Texel, within.slack().min((1.0 - within).slack()));
        (index as i64, within)
    }

    fn wrapped(&self, index: i64) -> usize {
        let wrapped = match self.wrap {
            Wrap::Repeat => index.rem_euclid(self.count),
            Wrap::ClampToEdge => index.clamp(0, self.count - 1),
            Wrap::MirroredRepeat => {
                let period = index.rem_euclid(2 * self.count);
                if period < self.count {
                    period
                } else {
                    2 * self.count - 1 - period
                }
            }
        };
        wrapped as usize
    }
}

fn decoded(image: &Image, i: usize, j: usize, decode: fn(u8) -> f64) -> Approx3 {
    let Texels::Bytes(texels) = &image.texels else {
        unreachable!("the scenes' images have 8 bits")
    };
    let [r, g, b, _] = texels[j * image.width as usize + i];
    Approx3::rounded([r, g, b].map(decode))
}

/// IEC 61966-2-1, its piecewise curve.
pub fn srgb(byte: u8) -> f64 {
    let v = f64::from(byte) / 255.0;
    if v <= 0.04045 {
        v / 12.92
    } else {
        ((v + 0.055) / 1.055).powf(2.4)
    }
}

fn linear(byte: u8) -> f64 {
    f64::from(byte) / 255.0
}

fn texture_on(material: &Material, parameter: Parameter) -> Option<TextureUse> {
    material.layer(parameter).map(|layer| layer.texture)
}

impl Shape {
    fn shaded_as(self, scene: &Scene, instance: &Instance, inputs: &Inputs, doubt: &mut Doubt) -> Surface {
        let material = &scene.materials[instance.material as usize];
        let Model::MetallicRoughness(model) = material.model else {
            unreachable!("the referee knows one model")
        };
        let [r, g, b, _] = material.base_color;
        let base = Approx3::exact_f32([r, g, b])
            * inputs.lookup(scene, texture_on(material, Parameter::BaseColor), srgb, doubt)
            * inputs.color;
        let grey = inputs.lookup(
            scene,
            texture_on(material, Parameter::MetallicRoughness),
            linear,
            doubt,
        );
        let roughness = (grey.y * f64::from(model.roughness)).clamp(0.0, 1.0);
        let metallic = (grey.z * f64::from(model.metallic)).clamp(0.0, 1.0);
        let textured = texture_on(material, Parameter::MetallicRoughness).is_some();
        let above_mirror = roughness.value - f64::from(MIRROR_ROUGHNESS);
        if textured {
            doubt.note(Decision::Mirror, above_mirror / roughness.error);
        }
        let emission = Approx3::exact_f32(material.emission)
            * inputs.lookup(scene, texture_on(material, Parameter::Emission), srgb, doubt);
        let dielectric = 1.0 - metallic;
        Surface {
            p: self.p,
            start: self.start,
            ng: self.ng,
            ns: self.ns,
            wo: self.wo,
            emission,
            c_diff: base * dielectric,
            f0: Approx3::splat(dielectric * Approx::rounded(0.04)) + base * metallic,
            alpha: roughness.squared(),
            is_mirror: above_mirror <= 0.0,
        }
    }
}

impl Surface {
    /// Schlick's Fresnel term.
    pub fn fresnel(&self, cos: Approx) -> Approx3 {
        let rest = (1.0 - cos.abs()).positive_part();
        let fifth = rest.squared().squared() * rest;
        self.f0 + (Approx3::ONE - self.f0) * fifth
    }

    /// What part of light from `wi` goes to the viewer: glTF 2.0, Appendix B.
    pub fn lobe(&self, wi: Approx3) -> Approx3 {
        let h = (wi + self.wo).normalize();
        let f = self.fresnel(self.wo.dot(h));
        let pi = Approx::rounded(std::f64::consts::PI);
        let diffuse = (Approx3::ONE - f) * self.c_diff * (Approx::ONE / pi);
        if self.alpha.value == 0.0 {
            return diffuse;
        }
        let a2 = self.alpha.squared();
        let [n_h, n_l, n_v] = [h, wi, self.wo].map(|w| self.ns.dot(w));
        // (N·H)²(α² - 1) + 1, with 1 - (N·H)² as |N×H|²: the bound of the difference would swallow sharp highlights.
        let across = self.ns.cross(h);
        let width = across.dot(across) + a2 * n_h.squared();
        // The peak, where the width is α², is as high as it gets; of that even f32 is sure, to a few roundings.
        let peak = Approx::ONE / (pi * a2);
        let d = (a2 / (pi * width.squared())).known_within(0.0, peak.value + 8.0 * peak.error);
        let smith = |cos: Approx| cos.abs() + (a2 + (1.0 - a2) * cos.squared()).sqrt();
        let v = Approx::ONE / (smith(n_l) * smith(n_v));
        diffuse + f * (d * v)
    }

    /// Whether a direction goes off the surface on the side that is seen.
    pub fn rises(&self, direction: Approx3, doubt: &mut Doubt) -> bool {
        let height = self.ng.dot(direction);
        doubt.note(Decision::Horizon, height.slack());
        height.value > 0.0
    }
}
