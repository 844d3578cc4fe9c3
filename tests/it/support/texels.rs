//! Material inputs of the reference tracer: vertex colours, texture coordinates, texels and procedural patterns.

use glam::{DMat3, DVec3};
use whit::mesh::Mesh;
use whit::scene::{Filter, Image, Scene, Space, Texels, Texture, TextureUse, UvTransform, Wrap};

use super::approx::{Approx, Approx3, ROUNDING};
use super::cones::{in_object, uv_of};
use super::hits::{Decision, Doubt, Found, corners, transform_vector};
use super::patterns::{gradient, middles, parts, second_share};
use super::shapes::Chart;

/// Returns the barycentric interpolation of values at the triangle's corners.
pub fn interpolate(mesh: &Mesh, found: &Found, corner: impl Fn(u32) -> Approx3) -> Approx3 {
    let [a, b, c] = mesh.triangles[found.primitive as usize].map(corner);
    // Use differences, so that uncertain weights count only as far as the corners differ; and add the roundings of a
    // weighted sum, which other implementations may compute.
    let largest = a.value().abs().max(b.value().abs()).max(c.value().abs());
    (a + (b - a) * found.u + (c - a) * found.v).widened(4.0 * ROUNDING * largest)
}

/// Inputs of a material at a hit.
pub struct Inputs<'a> {
    /// Vertex colour at the hit.
    pub color: Approx3,
    pub alpha: Approx,
    /// Texture coordinates by set, in object space.
    charts: Box<dyn Fn(u32) -> Chart + 'a>,
    /// Tangent of the mesh in object space, and its handedness.
    pub tangent: Option<(Approx3, f64)>,
    pub spot: Spot,
}

/// Texture footprint of a ray on a surface.
pub struct Spot {
    /// Point in object space, just under the surface.
    pub carved: Approx3,
    /// Axes of the ray's footprint in world space, the longer first.
    pub axes: [Approx3; 2],
    pub world_from_object: DMat3,
    pub object_from_world: DMat3,
}

/// Channels of a texel and the encoding of its bytes.
#[derive(Clone, Copy)]
pub enum Channels {
    /// RGB, encoded by the sRGB curve.
    Srgb,
    /// RGB, stored as linear values.
    Linear,
    /// Alpha channel, replicated to all three.
    Opacity,
}

impl<'a> Inputs<'a> {
    pub fn of_mesh(mesh: &'a Mesh, found: &'a Found, spot: Spot) -> Inputs<'a> {
        // Interpolate vertex colour and alpha
        let color = mesh.colors.as_ref().map_or(Approx3::ONE, |colors| {
            let rgb = |v: u32| {
                let [r, g, b, _] = colors[v as usize];
                Approx3::exact_f32([r, g, b])
            };
            interpolate(mesh, found, rgb)
        });
        let alpha = mesh.colors.as_ref().map_or(Approx::ONE, |colors| {
            let alpha = |v: u32| Approx3::exact_f32([colors[v as usize][3]; 3]);
            interpolate(mesh, found, alpha).x
        });
        // Interpolate the tangent; its handedness has the sign of the interpolated w
        let tangent = mesh.tangents.as_ref().map(|tangents| {
            let along = |v: u32| {
                let [x, y, z, _] = tangents[v as usize];
                Approx3::exact_f32([x, y, z])
            };
            let hand = |v: u32| Approx3::exact_f32([tangents[v as usize][3]; 3]);
            (
                interpolate(mesh, found, along),
                interpolate(mesh, found, hand).x.value.signum(),
            )
        });
        Inputs {
            color,
            alpha,
            charts: Box::new(move |set| mesh_chart(mesh, found, set)),
            tangent,
            spot,
        }
    }

    /// Creates the inputs of an analytic shape, which has one set of coordinates.
    pub fn of_shape(chart: Chart, spot: Spot) -> Inputs<'a> {
        Inputs {
            color: Approx3::ONE,
            alpha: Approx::ONE,
            charts: Box::new(move |_| chart),
            tangent: None,
            spot,
        }
    }

    /// Returns surface coordinates before any transform, and the point's derivatives by them in world space.
    pub fn chart(&self, set: u32) -> Chart {
        let chart = (self.charts)(set);
        let to_world = |d: Approx3| transform_vector(&self.spot.world_from_object, d);
        Chart {
            derivatives: chart.derivatives.map(to_world),
            ..chart
        }
    }

    /// Returns the value of the texture on a parameter, 1 if there is none.
    pub fn lookup(
        &self,
        scene: &Scene,
        texture: Option<TextureUse>,
        channels: Channels,
        doubt: &mut Doubt,
    ) -> Approx3 {
        let Some(used) = texture else {
            return Approx3::ONE;
        };
        // Transform coordinates and footprint to texture space
        let chart = self.chart(used.tex_coord);
        let uv = transformed(&used.transform, chart.uv);
        let axes = self.spot.axes.map(|axis| {
            let [u, v] = turned(&used.transform, uv_of(axis, chart.derivatives));
            plane([u, v])
        });
        // Filter an image, or evaluate a procedural texture
        match &scene.textures[used.texture as usize] {
            Texture::Image { image, sampler } => {
                let view = View {
                    image: &scene.images[*image as usize],
                    wraps: [sampler.wrap_u, sampler.wrap_v],
                    channels,
                };
                view.filtered(sampler.filter, uv, axes, doubt)
            }
            Texture::Procedural(procedural) => {
                let (p, axes) = match procedural.space {
                    Space::Uv => (plane(uv), axes),
                    Space::Object => (
                        self.spot.carved,
                        in_object(&self.spot.object_from_world, self.spot.axes),
                    ),
                };
                let second = second_share(procedural, p, axes);
                let [a, b] = procedural
                    .colors
                    .map(|color| Approx3::exact(channels.of_floats(color)));
                a * (1.0 - second) + b * second
            }
        }
    }

    /// Returns the slope of a height map, in R, along the surface's u and v; for a ray of zero width.
    pub fn slope(&self, scene: &Scene, used: TextureUse, doubt: &mut Doubt) -> [Approx; 2] {
        let chart = (self.charts)(used.tex_coord);
        let uv = transformed(&used.transform, chart.uv);
        let matrix = used.transform.matrix.map(|row| row.map(f64::from));
        let by_texture = match &scene.textures[used.texture as usize] {
            Texture::Image { image, sampler } => {
                let view = View {
                    image: &scene.images[*image as usize],
                    wraps: [sampler.wrap_u, sampler.wrap_v],
                    channels: Channels::Linear,
                };
                view.slope(uv, doubt)
            }
            Texture::Procedural(procedural) if procedural.space == Space::Object => {
                let rise = gradient(procedural, self.spot.carved);
                return chart.derivatives.map(|derivative| rise.dot(derivative));
            }
            Texture::Procedural(procedural) => {
                let rise = gradient(procedural, plane(uv));
                [rise.x, rise.y]
            }
        };
        [0, 1].map(|i| by_texture[0] * matrix[0][i] + by_texture[1] * matrix[1][i])
    }
}

fn plane([u, v]: [Approx; 2]) -> Approx3 {
    Approx3::from([u, v, Approx::ZERO])
}

/// Applies the linear part of `KHR_texture_transform`.
fn turned(transform: &UvTransform, [u, v]: [Approx; 2]) -> [Approx; 2] {
    transform
        .matrix
        .map(|row| u * f64::from(row[0]) + v * f64::from(row[1]))
}

fn transformed(transform: &UvTransform, uv: [Approx; 2]) -> [Approx; 2] {
    let [u, v] = turned(transform, uv);
    let [x, y] = transform.offset.map(|x| Approx::exact(f64::from(x)));
    [u + x, v + y]
}

/// Interpolates coordinates, and solves e = Δu dpdu + Δv dpdv of two edges for the derivatives.
fn mesh_chart(mesh: &Mesh, found: &Found, set: u32) -> Chart {
    let Some(coords) = mesh.tex_coords.get(set as usize) else {
        return Chart::NONE;
    };
    let uv_at = |v: u32| {
        let [u, v] = coords[v as usize];
        Approx3::exact_f32([u, v, 0.0])
    };
    let uv = interpolate(mesh, found, uv_at);
    let [p0, p1, p2] = corners(mesh, found.primitive);
    let [t0, t1, t2] = mesh.triangles[found.primitive as usize].map(|v| uv_at(v).value());
    let (e1, e2, d1, d2) = (p1 - p0, p2 - p0, t1 - t0, t2 - t0);
    let determinant = d1.x * d2.y - d1.y * d2.x;
    let by_u = (e1 * d2.y - e2 * d1.y) / determinant;
    let by_v = (e2 * d1.x - e1 * d2.x) / determinant;
    Chart {
        uv: [uv.x, uv.y],
        derivatives: [by_u, by_v].map(Approx3::rounded),
    }
}

/// Image with the parameters of a texture lookup.
struct View<'a> {
    image: &'a Image,
    wraps: [Wrap; 2],
    channels: Channels,
}

impl View<'_> {
    /// Returns the image's width and height.
    fn size(&self) -> DVec3 {
        DVec3::new(f64::from(self.image.width), f64::from(self.image.height), 1.0)
    }

    fn axes(&self, uv: [Approx; 2]) -> [Axis; 2] {
        let size = self.size();
        [0, 1].map(|i| Axis {
            at: uv[i] * size[i],
            count: size[i] as i64,
            wrap: self.wraps[i],
        })
    }

    fn texel(&self, [across, down]: &[Axis; 2], i: i64, j: i64) -> Approx3 {
        let index = down.wrapped(j) * self.image.width as usize + across.wrapped(i);
        match &self.image.texels {
            Texels::Bytes(texels) => Approx3::rounded(self.channels.of_bytes(texels[index])),
            Texels::Floats(texels) => Approx3::exact(self.channels.of_floats(texels[index])),
            Texels::Unread => Approx3::exact(self.channels.of_floats([1.0; 4])),
        }
    }

    fn bilinear(&self, uv: [Approx; 2], doubt: &mut Doubt) -> Approx3 {
        let axes = self.axes(uv);
        let (i, x) = axes[0].cell(0.5, doubt);
        let (j, y) = axes[1].cell(0.5, doubt);
        let mix = |a: Approx3, b: Approx3, w: Approx| a * (1.0 - w) + b * w;
        let top = mix(self.texel(&axes, i, j), self.texel(&axes, i + 1, j), x);
        let bottom = mix(self.texel(&axes, i, j + 1), self.texel(&axes, i + 1, j + 1), x);
        mix(top, bottom, y)
    }

    /// Filters a texel; `axes` are those of the ray's footprint in uv. If it is wider than a texel, mipmapped values
    /// have no bound.
    fn filtered(&self, filter: Filter, uv: [Approx; 2], axes: [Approx3; 2], doubt: &mut Doubt) -> Approx3 {
        match filter {
            Filter::Nearest => {
                let axes = self.axes(uv);
                let [i, j] = [0, 1].map(|k| axes[k].cell(0.0, doubt).0);
                self.texel(&axes, i, j)
            }
            Filter::Linear => self.bilinear(uv, doubt),
            Filter::Mipmap => {
                let [longer, shorter] = axes.map(|axis| (axis * Approx3::exact(self.size())).length());
                let ratio = longer / shorter;
                let whole = ratio - Approx::exact(ratio.value.round());
                doubt.note(Decision::Texel, whole.slack());
                let count = parts(ratio.value);
                let mut sum = Approx3::ZERO;
                for aside in middles(count) {
                    let at = [uv[0] + axes[0].x * aside, uv[1] + axes[0].y * aside];
                    sum = sum + self.bilinear(at, doubt);
                }
                let width = shorter.value.max(longer.value / count);
                let promised = if width < 1.0 { 0.0 } else { UNKNOWN };
                let mean = sum * (Approx::ONE / Approx::exact(count));
                mean.widened(DVec3::splat(promised))
            }
        }
    }

    /// Returns the slope of R over the texel around a point, per unit of uv.
    fn slope(&self, [u, v]: [Approx; 2], doubt: &mut Doubt) -> [Approx; 2] {
        let [w, h] = [self.image.width, self.image.height].map(f64::from);
        let mut rise = |du: f64, dv: f64| {
            let [du, dv] = [du, dv].map(Approx::exact);
            let (up, down) = ([u + du, v + dv], [u - du, v - dv]);
            self.bilinear(up, doubt).x - self.bilinear(down, doubt).x
        };
        [rise(0.5 / w, 0.0) * w, rise(0.0, 0.5 / h) * h]
    }
}

/// Error bound of a value that cannot be predicted.
const UNKNOWN: f64 = 1e30;

impl Channels {
    fn of_bytes(self, [r, g, b, a]: [u8; 4]) -> [f64; 3] {
        match self {
            Channels::Srgb => [r, g, b].map(srgb),
            Channels::Linear => [r, g, b].map(linear),
            Channels::Opacity => [linear(a); 3],
        }
    }

    fn of_floats(self, [r, g, b, a]: [f32; 4]) -> [f64; 3] {
        match self {
            Channels::Srgb | Channels::Linear => [r, g, b].map(f64::from),
            Channels::Opacity => [f64::from(a); 3],
        }
    }
}

/// Texture coordinate along one axis, in texels.
struct Axis {
    at: Approx,
    count: i64,
    wrap: Wrap,
}

impl Axis {
    /// Returns the cell of unit length that contains the coordinate, the first of which starts at `offset`, and the
    /// position in it.
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

/// Decodes a byte by the piecewise curve of IEC 61966-2-1.
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
