//! Surface interaction of the reference tracer: normals, texture values and Phong's highlight.

use glam::{DAffine3, DVec3, Vec3};
use whit::mesh::Mesh;
use whit::optics::LINE_D;
use whit::scene::{
    AlphaMode, Geometry, Instance, Material, MaterialInput, MetallicRoughness, Model, Phong, Scene,
    TextureUse,
};
use whit::shape;

use super::approx::{Approx, Approx3, ROUNDING};
use super::cones::{Cone, curvature_of};
use super::gltf_lobe::{Gltf, lobe_albedo};
use super::hits::{Decision, Doubt, Found, Ray, World, corners, norm, transform_point, transform_vector};
use super::normals::{bend_toward_viewer, bumped, frame_of_chart, frame_of_tangent, mapped};
use super::shapes;
use super::texels::{Channels, Inputs, Spot, interpolate};

/// Largest roughness of a surface that counts as a mirror.
const MIRROR_ROUGHNESS: f32 = 0.1;

/// Surface point at the hit of a ray, in world space.
pub struct Surface {
    /// Position of the hit.
    pub p: Approx3,
    /// Origin of rays that leave the surface: the hit, with the offset of a program's spawned rays as its error.
    pub start: Approx3,
    /// Geometric normal, on the viewer's side.
    pub ng: Approx3,
    /// Shading normal, with normal and bump maps.
    pub ns: Approx3,
    /// Unit direction to the viewer.
    pub wo: Approx3,
    /// True if seen from outside: the front of a triangle, the outer side of a sphere.
    pub is_outside: bool,
    /// Ray cone at the hit, for texture filtering.
    pub cone: Cone,
    /// Mean curvature 1 / r, positive if the surface is convex to the viewer.
    pub curvature: Approx,
    /// Alpha coverage at the hit.
    pub coverage: Approx,
    pub emission: Approx3,
    /// Factor of the ambient light.
    pub ambient: Approx3,
    /// Reflection model for the light of light sources.
    pub response: Response,
    /// Mirror reflectance if the surface is opaque.
    pub mirror: Mirror,
    /// Tint of transmitted light: zero for an opaque surface.
    pub tint: Approx3,
    /// Tint of light that a transmissive boundary reflects.
    pub reflected_tint: Approx3,
    /// True if Fresnel's equations divide the light at a transmissive boundary.
    pub obeys_fresnel: bool,
    /// True if a transmissive boundary spawns a mirror ray.
    pub is_smooth: bool,
}

/// Reflection model with its coefficients.
pub enum Response {
    Gltf(Gltf),
    Phong {
        /// Diffuse coefficient rd, times the base colour.
        diffuse: Approx3,
        /// Specular coefficient rsp of Phong's model.
        specular: Approx3,
        /// Exponent f of Phong's highlight.
        exponent: f64,
    },
}

/// Mirror reflectance of a surface.
pub enum Mirror {
    None,
    /// Constant reflectance at all angles: Whitted's kr.
    Constant(Approx3),
    /// Reflectance by Schlick's approximation.
    Schlick(Gltf),
}

impl Surface {
    pub fn new(world: &World, ray: &Ray, found: &Found, doubt: &mut Doubt) -> Surface {
        let scene = world.scene;
        let instance = &scene.instances[found.instance as usize];
        // Set up the instance and the direction to the viewer
        let place = Place {
            instance,
            object_from_world: &world.object_from_world[found.instance as usize],
            wo: -ray.direction.normalize(),
        };
        let cone = ray.cone.after(found.t * ray.direction.length());
        // Compute the geometry, then evaluate the material there
        match &scene.geometries[instance.geometry as usize] {
            Geometry::Mesh(mesh) => {
                let shape = place.on_triangle(mesh, found, doubt);
                let spot = place.spot(&shape, cone);
                let curvature = mesh_curvature(mesh, found);
                let inputs = Inputs::of_mesh(mesh, found, spot);
                shape.shaded_as(scene, instance, &inputs, (cone, curvature), doubt)
            }
            Geometry::Points(_) => panic!("the textbook has no point clouds"),
            Geometry::Shape(kind) => {
                let face = world.face(instance.geometry, found.primitive);
                let p = face.point(place.object_from_world, ray, found.t.value);
                let outward = face.outward(p);
                let curvature = match kind {
                    shape::Shape::Sphere(sphere) => 1.0 / sphere.radius,
                    _ => 0.0,
                };
                let shape = place.on_shape(p, outward, doubt);
                let spot = place.spot(&shape, cone);
                let inputs = Inputs::of_shape(shapes::chart(kind, found.primitive, p), spot);
                shape.shaded_as(scene, instance, &inputs, (cone, curvature), doubt)
            }
        }
    }
}

/// Returns the curvature that the corner normals imply; 0 for a flat mesh.
fn mesh_curvature(mesh: &Mesh, found: &Found) -> f64 {
    mesh.normals.as_ref().map_or(0.0, |normals| {
        let wide = |v: u32| Vec3::from(normals[v as usize]).as_dvec3().normalize_or_zero();
        let n = mesh.triangles[found.primitive as usize].map(wide);
        curvature_of(corners(mesh, found.primitive), n)
    })
}

/// Geometric part of a [`Surface`].
struct Shape {
    p: Approx3,
    start: Approx3,
    ng: Approx3,
    ns: Approx3,
    wo: Approx3,
    is_outside: bool,
    /// Point and outward normal in object space.
    local: [Approx3; 2],
}

/// Instance and ray of a hit, with their transforms.
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
        // Counterclockwise order in object space is outside; a mirroring transform reverses it.
        let winding = e1.cross(e2).normalize();
        let outward = if map.matrix3.determinant() < 0.0 {
            -winding
        } else {
            winding
        };
        let ng = facing(outward, self.wo, doubt);
        let size =
            [v0, v1, v2].iter().fold(DVec3::ZERO, |m, v| m.max(v.abs())) + (v1 - v0).abs() + (v2 - v0).abs();
        let mut ns = self.interpolated_normal(mesh, found, ng, doubt).unwrap_or(ng);
        let seen = ns.dot(self.wo);
        doubt.note(Decision::Facing, seen.slack());
        if seen.value <= 0.0 {
            ns = ng;
        }
        let is_outside = outward.dot(self.wo).value >= 0.0;
        let n = Approx3::exact(v1 - v0).cross(Approx3::exact(v2 - v0));
        self.shape([p, n], size, [ng, ns], is_outside)
    }

    fn on_shape(&self, p: Approx3, outward: Approx3, doubt: &mut Doubt) -> Shape {
        let n = self.transform_normal(outward);
        let ng = facing(n, self.wo, doubt);
        let is_outside = n.dot(self.wo).value >= 0.0;
        self.shape([p, outward], p.value().abs(), [ng, ng], is_outside)
    }

    /// Combines the parts; `size` is the largest coordinate used in finding `p`, in object space.
    fn shape(&self, local: [Approx3; 2], size: DVec3, [ng, ns]: [Approx3; 2], is_outside: bool) -> Shape {
        let p = local[0];
        // The offset of spawned rays is a few roundings of the coordinates and of the triangle's size.
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
            is_outside,
            local,
        }
    }

    /// Returns the texture footprint of the ray. A procedural texture's point is just under the surface: the depth is
    /// left open, up to a few roundings of the coordinates in either space.
    fn spot(&self, shape: &Shape, cone: Cone) -> Spot {
        let map = self.instance.world_from_object();
        let [p, n] = shape.local;
        let n = n.normalize();
        let inverse = &self.object_from_world.matrix3;
        let condition = norm(&map.matrix3) * norm(inverse);
        let most = condition * shapes::step(p) + norm(inverse) * shapes::step(shape.p);
        // The offset along the normal has at most that error, and sideways as much as the normal has.
        let below = p.value() - 0.5 * most * n.value();
        let aside = n
            .value()
            .map(|x| most * (0.499 * x.abs()).max((1.0 - x * x).max(0.0).sqrt()));
        Spot {
            carved: Approx3::exact(below).widened(p.error() + aside),
            axes: cone.footprint(-shape.wo, shape.ng),
            world_from_object: map.matrix3,
            object_from_world: *inverse,
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

    /// Transforms a normal by the inverse transpose, which keeps it perpendicular to the surface.
    fn transform_normal(&self, n: Approx3) -> Approx3 {
        transform_vector(&self.object_from_world.matrix3.transpose(), n.normalize()).normalize()
    }
}

/// Returns `n` or its opposite, whichever is on the side of `toward`.
fn facing(n: Approx3, toward: Approx3, doubt: &mut Doubt) -> Approx3 {
    let side = n.dot(toward);
    doubt.note(Decision::Facing, side.slack());
    if side.value < 0.0 { -n } else { n }
}

fn texture_on(material: &Material, parameter: MaterialInput) -> Option<TextureUse> {
    material.layer(parameter).map(|layer| layer.texture)
}

/// Evaluator of a material's parameters with textures and vertex colours.
struct Looks<'a> {
    scene: &'a Scene,
    material: &'a Material,
    inputs: &'a Inputs<'a>,
    doubt: &'a mut Doubt,
}

impl Looks<'_> {
    fn lookup(&mut self, parameter: MaterialInput, channels: Channels) -> Approx3 {
        let texture = texture_on(self.material, parameter);
        self.inputs.lookup(self.scene, texture, channels, self.doubt)
    }

    fn base(&mut self) -> Approx3 {
        let [r, g, b, _] = self.material.base_color;
        Approx3::exact_f32([r, g, b])
            * self.lookup(MaterialInput::BaseColor, Channels::Srgb)
            * self.inputs.color
    }

    /// Returns the alpha coverage (glTF 2.0, 3.9.4).
    fn coverage(&mut self) -> Approx {
        if self.material.alpha == AlphaMode::Opaque {
            return Approx::ONE;
        }
        let factor = Approx::exact(f64::from(self.material.base_color[3]));
        let alpha = factor * self.lookup(MaterialInput::BaseColor, Channels::Opacity).x * self.inputs.alpha;
        match self.material.alpha {
            AlphaMode::Mask(cutoff) => {
                let above = alpha - Approx::exact(f64::from(cutoff));
                self.doubt.note(Decision::Coverage, above.slack());
                if above.value >= 0.0 {
                    Approx::ONE
                } else {
                    Approx::ZERO
                }
            }
            _ => alpha.clamp(0.0, 1.0),
        }
    }

    fn gltf(&mut self, model: &MetallicRoughness, cos: Approx) -> Shades {
        // Look up the textured parameters
        let base = self.base();
        let textured = [MaterialInput::MetallicRoughness, MaterialInput::Roughness]
            .into_iter()
            .any(|parameter| texture_on(self.material, parameter).is_some());
        let grey = self.lookup(MaterialInput::MetallicRoughness, Channels::Linear);
        let rough = self.lookup(MaterialInput::Roughness, Channels::Linear).x * f64::from(model.roughness);
        let metal = self.lookup(MaterialInput::Metallic, Channels::Linear).x * f64::from(model.metallic);
        let roughness = (grey.y * rough).clamp(0.0, 1.0);
        let metallic = (grey.z * metal).clamp(0.0, 1.0);
        // Decide whether the surface is a mirror
        let above_mirror = roughness.value - f64::from(MIRROR_ROUGHNESS);
        if textured {
            self.doubt.note(Decision::Mirror, above_mirror / roughness.error);
        }
        let is_mirror = above_mirror <= 0.0;
        let dielectric = 1.0 - metallic;
        let specular = Approx::exact(f64::from(model.specular))
            * self.lookup(MaterialInput::Specular, Channels::Opacity).x;
        let specular_color = Approx3::exact_f32(model.specular_color)
            * self.lookup(MaterialInput::SpecularColor, Channels::Srgb);
        let through =
            self.lookup(MaterialInput::Transmission, Channels::Linear).x * f64::from(model.transmission);
        // Compute the reflectance at normal incidence from the index
        let normal_incidence = self.material.interior.map_or(0.04, |inside| {
            let n = inside.ior.ior(LINE_D);
            ((n - 1.0) / (n + 1.0)).powi(2)
        });
        let f0 = Approx3::from(
            (specular_color * Approx::rounded(normal_incidence))
                .to_array()
                .map(|v| v.clamp(0.0, 1.0)),
        );
        // Mix the dielectric and the metallic lobe
        let gltf = Gltf {
            c_diff: base * (dielectric * (1.0 - through)),
            f0: f0 * (specular * dielectric) + base * metallic,
            f90: specular * dielectric + metallic,
            alpha: roughness.squared(),
            albedo: lobe_albedo(cos, roughness),
        };
        let albedo = gltf.specular_albedo();
        // A mirror reflects its environment by rays, not by the lobe.
        let glossy = if is_mirror { Approx3::ZERO } else { albedo };
        Shades {
            ambient: gltf.c_diff * (Approx3::ONE - albedo) + glossy,
            response: Response::Gltf(gltf),
            mirror: if is_mirror {
                Mirror::Schlick(gltf)
            } else {
                Mirror::None
            },
            tint: base * (through * dielectric),
            reflected_tint: specular_color * specular,
            obeys_fresnel: true,
            is_smooth: is_mirror,
        }
    }

    /// Returns the shading normal on the viewer's side, perturbed by normal map and bump map in the order of the
    /// layers.
    fn bent(&mut self, shape: &Shape, instance: &Instance) -> Approx3 {
        let outward = |n: Approx3| if shape.is_outside { n } else { -n };
        let mut bent = None;
        for layer in &self.material.layers {
            let n = bent.unwrap_or_else(|| outward(shape.ns));
            let used = layer.texture;
            let chart = self.inputs.chart(used.tex_coord);
            match layer.parameter {
                MaterialInput::Normal => {
                    let texel = self.lookup(MaterialInput::Normal, Channels::Linear);
                    let n = outward(shape.ns);
                    let map = instance.world_from_object().matrix3;
                    let frame = match self.inputs.tangent {
                        Some((tangent, hand)) => {
                            // Under a mirroring transform the tangent is mirrored too, and the normal stays outside.
                            let hand = hand * map.determinant();
                            frame_of_tangent(n, transform_vector(&map, tangent), hand)
                        }
                        None if chart.is_empty() => continue,
                        None => frame_of_chart(n, &chart, &used.transform),
                    };
                    bent = Some(mapped(n, frame, texel, layer));
                }
                MaterialInput::Bump if chart.is_empty() => bent = Some(n),
                MaterialInput::Bump => {
                    let slope = self.inputs.slope(self.scene, used, self.doubt);
                    let height = Approx::exact(f64::from(layer.strength));
                    bent = Some(bumped(n, &chart, slope.map(|s| s * height)));
                }
                _ => {}
            }
        }
        bent.map_or(shape.ns, |n| {
            bend_toward_viewer(outward(n), shape.ng, shape.wo, self.doubt)
        })
    }

    fn phong(&mut self, model: &Phong) -> Shades {
        let base = self.base();
        let reflection =
            Approx3::exact_f32(model.reflection) * self.lookup(MaterialInput::Reflection, Channels::Linear);
        let through = Approx3::exact_f32(model.transmission)
            * self.lookup(MaterialInput::Transmission, Channels::Linear);
        Shades {
            ambient: Approx3::exact_f32(model.ambient) * base,
            response: Response::Phong {
                diffuse: Approx3::exact_f32(model.diffuse) * base,
                specular: Approx3::exact_f32(model.specular)
                    * self.lookup(MaterialInput::SpecularColor, Channels::Srgb),
                exponent: f64::from(model.exponent),
            },
            mirror: if model.reflection == [0.0; 3] {
                Mirror::None
            } else {
                Mirror::Constant(reflection)
            },
            tint: through,
            reflected_tint: reflection,
            obeys_fresnel: model.fresnel,
            is_smooth: true,
        }
    }
}

/// Part of a [`Surface`] that depends on the reflection model.
struct Shades {
    ambient: Approx3,
    response: Response,
    mirror: Mirror,
    tint: Approx3,
    reflected_tint: Approx3,
    obeys_fresnel: bool,
    is_smooth: bool,
}

/// Coefficients of a Phong surface that reflects no light of light sources.
const SILENT: Phong = Phong {
    ambient: [0.0; 3],
    diffuse: [0.0; 3],
    ..Phong::DEFAULT
};

impl Shape {
    fn shaded_as(
        self,
        scene: &Scene,
        instance: &Instance,
        inputs: &Inputs,
        (cone, curvature): (Cone, f64),
        doubt: &mut Doubt,
    ) -> Surface {
        let material = &scene.materials[instance.material as usize];
        // Perturb the shading normal
        let mut looks = Looks {
            scene,
            material,
            inputs,
            doubt,
        };
        let ns = looks.bent(&self, instance);
        let scale = instance.world_from_object().matrix3.determinant().abs().cbrt();
        let curvature = Approx::rounded(curvature / scale);
        // Evaluate the reflection model
        let shades = match &material.model {
            Model::MetallicRoughness(model) => looks.gltf(model, ns.dot(self.wo).abs()),
            Model::Phong(model) => looks.phong(model),
            Model::Unlit => looks.phong(&SILENT),
        };
        // Look up emission and occlusion
        let emission = match &material.model {
            Model::Unlit => looks.base(),
            _ => {
                Approx3::exact_f32(material.emission) * looks.lookup(MaterialInput::Emission, Channels::Srgb)
            }
        };
        let occlusion = material
            .layer(MaterialInput::Occlusion)
            .map_or(Approx::ONE, |layer| {
                let lit = looks.lookup(MaterialInput::Occlusion, Channels::Linear).x;
                1.0 - (1.0 - lit) * f64::from(layer.strength)
            });
        Surface {
            p: self.p,
            start: self.start,
            ng: self.ng,
            ns,
            wo: self.wo,
            is_outside: self.is_outside,
            cone,
            curvature: if self.is_outside { curvature } else { -curvature },
            coverage: looks.coverage(),
            emission,
            ambient: shades.ambient * occlusion,
            response: shades.response,
            mirror: shades.mirror,
            tint: shades.tint,
            reflected_tint: shades.reflected_tint,
            obeys_fresnel: shades.obeys_fresnel,
            is_smooth: shades.is_smooth,
        }
    }
}

impl Surface {
    /// Returns whether light passes through the surface where its coverage is not 0.
    pub fn lets_through(&self) -> bool {
        self.tint.value() != DVec3::ZERO
    }

    /// Returns the mirror reflectance at this cosine with the normal; `None` for a surface without mirror reflection.
    pub fn mirror_share(&self, cos: Approx) -> Option<Approx3> {
        match &self.mirror {
            Mirror::None => None,
            Mirror::Constant(share) => Some(*share),
            Mirror::Schlick(gltf) => Some(gltf.fresnel(cos)),
        }
    }

    /// Returns the radiance to the viewer for a unit of light from `wi`, whose cosine with the normal is `cos`, if
    /// positive.
    pub fn response(&self, wi: Approx3, cos: Approx, doubt: &mut Doubt) -> Approx3 {
        match &self.response {
            Response::Gltf(gltf) => gltf.lobe(self.ns, self.wo, wi) * cos,
            Response::Phong {
                diffuse,
                specular,
                exponent,
            } => {
                let s_m = self.ns.dot(wi);
                if specular.value() == DVec3::ZERO {
                    return *diffuse * cos;
                }
                doubt.note(Decision::Horizon, s_m.slack());
                // The vector r is s mirrored at the normal.
                let r = self.ns * (s_m + s_m) - wi;
                let highlight = r.dot(self.wo).clamp(0.0, 1.0).powf(*exponent);
                *diffuse * cos + *specular * highlight
            }
        }
    }

    /// Returns whether a direction leaves the surface on the visible side.
    pub fn rises(&self, direction: Approx3, doubt: &mut Doubt) -> bool {
        let height = self.ng.dot(direction);
        doubt.note(Decision::Horizon, height.slack());
        height.value > 0.0
    }
}
