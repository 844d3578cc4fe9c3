//! What a surface and its textures bring to a material: vertex colours, coordinates, texels, patterns.

use glam::{DMat3, DVec3};
use whit::mesh::Mesh;
use whit::scene::{Filter, Image, Scene, Space, Texels, Texture, TextureUse, UvTransform, Wrap};

use super::approx::{Approx, Approx3, ROUNDING};
use super::cones::{in_object, uv_of};
use super::hits::{Decision, Doubt, Found, corners, transform_vector};
use super::patterns::{gradient, middles, parts, second_share};
use super::shapes::Chart;

/// The barycentric mean of what the triangle's corners have.
pub fn interpolate(mesh: &Mesh, found: &Found, corner: impl Fn(u32) -> Approx3) -> Approx3 {
    let [a, b, c] = mesh.triangles[found.primitive as usize].map(corner);
    // By differences, so that doubt about the weights counts only as far as the corners differ; and the roundings of
    // a weighted sum, which is what others may compute.
    let largest = a.value().abs().max(b.value().abs()).max(c.value().abs());
    (a + (b - a) * found.u + (c - a) * found.v).widened(4.0 * ROUNDING * largest)
}

/// What a hit brings to its material.
pub struct Inputs<'a> {
    /// The vertex colour.
    pub color: Approx3,
    pub alpha: Approx,
    /// By sets of texture coordinates, in object space.
    charts: Box<dyn Fn(u32) -> Chart + 'a>,
    /// The mesh's tangent in object space, and its handedness.
    pub tangent: Option<(Approx3, f64)>,
    pub spot: Spot,
}

/// What a ray sees of a surface, for textures.
pub struct Spot {
    /// The point in object space, just under the surface.
    pub carved: Approx3,
    /// The axes of the ray's footprint in world space, the longer first.
    pub axes: [Approx3; 2],
    pub world_from_object: DMat3,
    pub object_from_world: DMat3,
}

/// Which channels of a texel count, and how bytes are meant.
#[derive(Clone, Copy)]
pub enum Channels {
    /// RGB by the sRGB curve.
    Srgb,
    /// RGB.
    Linear,
    /// The fourth channel, thrice.
    Opacity,
}

impl<'a> Inputs<'a> {
    pub fn of_mesh(mesh: &'a Mesh, found: &'a Found, spot: Spot) -> Inputs<'a> {
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

    /// Of an analytic shape, which has one set of coordinates.
    pub fn of_shape(chart: Chart, spot: Spot) -> Inputs<'a> {
        Inputs {
            color: Approx3::ONE,
            alpha: Approx::ONE,
            charts: Box::new(move |_| chart),
            tangent: None,
            spot,
        }
    }

    /// Surface coordinates before any transform, and the point's derivatives by them in world space.
    pub fn chart(&self, set: u32) -> Chart {
        let chart = (self.charts)(set);
        let to_world = |d: Approx3| transform_vector(&self.spot.world_from_object, d);
        Chart {
            derivatives: chart.derivatives.map(to_world),
            ..chart
        }
    }

    /// The value of the texture on a parameter, 1 where there is none.
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
        let chart = self.chart(used.tex_coord);
        let uv = transformed(&used.transform, chart.uv);
        let axes = self.spot.axes.map(|axis| {
            let [u, v] = turned(&used.transform, uv_of(axis, chart.derivatives));
            plane([u, v])
        });
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

    /// How a height map, in R, rises by the surface's own u and v; of a ray without width.
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

/// The linear part of `KHR_texture_transform`.
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

/// Coordinates by their weights, and derivatives from e = Δu dpdu + Δv dpdv of two edges.
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

/// An image as it is looked up.
struct View<'a> {
    image: &'a Image,
    wraps: [Wrap; 2],
    channels: Channels,
}

impl View<'_> {
    /// The image's width and height.
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

    /// `axes` are those of the ray's footprint in uv. Where it is wider than a texel, nothing is promised of mipmaps.
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

    /// The rise of R over the texel around a point, a unit of uv.
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

/// Beyond all bounds.
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
