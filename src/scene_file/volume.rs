//! Volumes and fog of scene files: `[[volume]]` and `[fog]`.

use std::path::Path;
use std::sync::Arc;

use glam::DAffine3;
use schemars::JsonSchema;
use serde::Deserialize;

use super::fault::Diagnostic;
use super::placement::{Step, map_of};
use super::value::{Color, Located};
use crate::volume::cloud::{Cloud, CloudShape};
use crate::volume::read::{ByteOrder, Element, RawHeader, ReadVolume, read, read_raw};
use crate::volume::{Fog, Grid, Thickness, Transfer, TransferNode, Volume, VolumeDescription, VolumeError};

/// A volume in the cube [-1, 1]³: exactly one of `file`, `raw` and `cloud`, the transfer function of its numbers, and
/// its transform.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct VolumeForm {
    /// Name of the volume in messages.
    pub(super) name: Option<Located<String>>,
    /// A .npy, .nrrd or .nhdr file, relative to this one, with one number per sample (density) or four (red, green,
    /// blue, density).
    file: Option<Located<String>>,
    /// Placement of the cube by the NRRD file's own transform, before `transform`.
    #[serde(default)]
    file_placement: bool,
    /// A file of raw numbers, relative to this one, and their format.
    raw: Option<Located<RawForm>>,
    /// Procedural noise instead of a file.
    cloud: Option<Located<CloudForm>>,
    /// Transforms of the cube, applied in the order written.
    #[serde(default)]
    transform: Vec<Located<Step>>,
    /// Length of a ray-marching step in metres; half the shortest edge of a voxel if absent.
    step: Option<f64>,
    /// Transfer function: nodes with rising values, between which everything is interpolated.
    transfer: Located<Vec<NodeForm>>,
    /// Length in metres over which the nodes' `opacity` holds; only with `opacity`.
    opacity_over: Option<f64>,
}

/// A node of the transfer function.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct NodeForm {
    /// Number of the volume that the node describes.
    value: f64,
    /// Extinction coefficient per metre: the fraction of the light that a metre of thin medium removes;
    /// exp(-extinction) remains after a metre.
    extinction: Option<f64>,
    /// Instead of `extinction`, the fraction of the light that the length `opacity_over` removes, 0 to 1.
    opacity: Option<f64>,
    /// Albedo: the fraction of the removed light that is scattered.
    #[serde(default = "white")]
    #[schemars(extend("default" = 1.0))]
    color: Color,
    /// Radiance emitted per metre.
    #[serde(default = "black")]
    #[schemars(extend("default" = 0.0))]
    emission: Color,
}

/// A file of raw numbers, x fastest.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct RawForm {
    /// Path of the file, relative to this one.
    file: String,
    /// Numbers of samples along x, y and z.
    size: [usize; 3],
    /// The type of a number.
    r#type: Element,
    /// Numbers per sample: 1 (density) or 4 (red, green, blue, density).
    #[serde(default = "one")]
    #[schemars(extend("default" = 1))]
    channels: usize,
    /// Byte order of a number.
    #[serde(default)]
    order: ByteOrder,
    /// Number of bytes before the first number.
    #[serde(default)]
    skip: u64,
}

/// Fractal noise in a shape, with densities from 0 to 1.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct CloudForm {
    /// Shape that the noise roughens: the whole cube, a ball, or a column of smoke that rises along +y.
    shape: CloudShapeForm,
    /// Numbers of samples along x, y and z.
    #[schemars(extend("default" = CLOUD_SIZE))]
    size: Option<[usize; 3]>,
    /// Number of cells of the coarsest noise along half the cube's side.
    #[schemars(extend("default" = Cloud::SMOKE.frequency))]
    frequency: Option<f64>,
    /// Number of octaves of noise, 1 to 16.
    #[schemars(extend("default" = Cloud::SMOKE.octaves))]
    octaves: Option<u32>,
    /// Share of the noise in the density; 0 is the plain shape.
    #[schemars(extend("default" = Cloud::SMOKE.roughness))]
    roughness: Option<f64>,
    /// Density at which the cloud begins, 0 to 1.
    #[schemars(extend("default" = Cloud::SMOKE.threshold))]
    threshold: Option<f64>,
    /// Seed of the noise.
    #[schemars(extend("default" = Cloud::SMOKE.seed))]
    seed: Option<u32>,
}

#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum CloudShapeForm {
    Layer,
    Puff,
    Plume,
}

/// Homogeneous fog, which fills all space.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct FogForm {
    /// Extinction coefficient per metre: the fraction of the light that a metre of thin fog removes; exp(-extinction)
    /// remains after a metre.
    extinction: f64,
    /// Albedo: the fraction of the removed light that is scattered.
    #[serde(default = "white")]
    #[schemars(extend("default" = 1.0))]
    color: Color,
    /// Radiance emitted per metre.
    #[serde(default = "black")]
    #[schemars(extend("default" = 0.0))]
    emission: Color,
    /// Length of a ray-marching step in metres; a quarter of 1 / extinction if absent.
    step: Option<f64>,
}

fn white() -> Color {
    Color::WHITE
}

fn black() -> Color {
    Color([0.0; 3])
}

fn one() -> usize {
    1
}

/// Default number of samples of a cloud along each side.
const CLOUD_SIZE: [usize; 3] = [64; 3];
/// Largest number of octaves of noise, as in textures.
const MAX_OCTAVES: u32 = 16;
/// Default number of fog steps over the length after which 1 / e of the light remains.
const FOG_STEPS: f64 = 4.0;

/// A volume of a file before it is placed in the world.
#[derive(Clone, Debug)]
pub(super) struct MadeVolume {
    pub(super) name: Arc<str>,
    pub(super) description: VolumeDescription,
}

impl MadeVolume {
    /// Returns the size of the volume's grids in bytes.
    pub(super) fn bytes(&self) -> u64 {
        let colors = self.description.color.iter().flat_map(|color| color.iter());
        let bytes = self.description.density.memory() + colors.map(Grid::memory).sum::<usize>();
        bytes as u64
    }

    /// Returns the volume transformed by `world`.
    pub(super) fn placed(&self, world: &DAffine3) -> Result<Volume, VolumeError> {
        let description = VolumeDescription {
            world_from_cube: *world * self.description.world_from_cube,
            ..self.description.clone()
        };
        Ok(Volume::new(description)?.named(self.name.clone()))
    }
}

impl VolumeForm {
    /// Returns the volume with index `number` in a file in `folder`, of at most `max_bytes`.
    pub(super) fn volume(
        form: &Located<VolumeForm>,
        number: usize,
        folder: &Path,
        max_bytes: u64,
    ) -> Result<MadeVolume, Diagnostic> {
        // Compose the transform and the transfer function
        let map = map_of(form.transform.iter().map(|step| &**step))
            .map_err(|(step, sentence)| form.transform[step].fault(sentence))?;
        let transfer = form
            .transfer()
            .map_err(|sentence| form.transfer.fault(sentence))?;
        // Read the samples and their placement
        let read = VolumeForm::samples(form, folder, max_bytes)?;
        let placed = match (form.file_placement, read.world_from_cube) {
            (false, _) => DAffine3::IDENTITY,
            (true, Some(map)) => map,
            (true, None) => {
                let sentence = "has no placement in its file: remove `file_placement` and give a `transform`";
                return Err(form.fault(sentence));
            }
        };
        // Separate the density from the colours
        let (density, color) = channels(read.channels).map_err(|sentence| form.fault(sentence))?;
        let name = form.name.as_ref();
        Ok(MadeVolume {
            name: name.map_or_else(|| format!("volume {}", number + 1).into(), |n| n.as_str().into()),
            description: VolumeDescription {
                density,
                color,
                transfer,
                world_from_cube: map * placed,
                step: form.step,
            },
        })
    }

    fn samples(form: &Located<VolumeForm>, folder: &Path, max_bytes: u64) -> Result<ReadVolume, Diagnostic> {
        match (&form.file, &form.raw, &form.cloud) {
            (Some(file), None, None) => {
                read(&folder.join(&**file), max_bytes).map_err(|error| file.fault(error.to_string()))
            }
            (None, Some(raw), None) => read_raw(&folder.join(&raw.file), &raw.header(), max_bytes)
                .map_err(|error| raw.fault(error.to_string())),
            (None, None, Some(cloud)) => {
                let grid = cloud.grid(max_bytes).map_err(|sentence| cloud.fault(sentence))?;
                Ok(ReadVolume {
                    channels: vec![grid],
                    world_from_cube: None,
                })
            }
            _ => Err(form.fault("is ambiguous or incomplete: give exactly one of `file`, `raw` and `cloud`")),
        }
    }

    fn transfer(&self) -> Result<Transfer, String> {
        // The presence of a length decides how nodes give their thickness
        let thickness = match self.opacity_over {
            Some(length) => Thickness::OpacityOver(length),
            None => Thickness::Extinction,
        };
        let mut nodes = Vec::with_capacity(self.transfer.len());
        // Read each node's extinction or opacity, whichever the volume uses
        for (number, form) in self.transfer.iter().enumerate() {
            let number = number + 1;
            let amount = match (thickness, form.extinction, form.opacity) {
                (Thickness::Extinction, Some(extinction), None) => extinction,
                (Thickness::OpacityOver(_), None, Some(opacity)) => opacity,
                (Thickness::Extinction, None, Some(_)) => {
                    return Err(format!(
                        "node {number} has an opacity without a reference length: add `opacity_over` to the volume"
                    ));
                }
                (Thickness::Extinction, ..) => {
                    return Err(format!(
                        "node {number} is ambiguous or incomplete: give `extinction`"
                    ));
                }
                (Thickness::OpacityOver(_), ..) => {
                    return Err(format!(
                        "node {number} is ambiguous or incomplete: give `opacity`, or remove `opacity_over`"
                    ));
                }
            };
            nodes.push(TransferNode {
                value: form.value,
                thickness: amount,
                color: form.color.0.map(f64::from),
                emission: form.emission.0.map(f64::from),
            });
        }
        Transfer::new(&nodes, thickness).map_err(|fault| fault.to_string())
    }
}

/// Density grid of a volume, and its colour grids if there are any.
type Grids = (Arc<Grid>, Option<Arc<[Grid; 3]>>);

/// Returns the density, and the colours if there are any.
fn channels(mut grids: Vec<Grid>) -> Result<Grids, String> {
    let count = grids.len();
    // The density is the last channel
    let density = grids.pop();
    match (density, <[Grid; 3]>::try_from(grids)) {
        (Some(density), Err(others)) if others.is_empty() => Ok((Arc::new(density), None)),
        (Some(density), Ok(colors)) => Ok((Arc::new(density), Some(Arc::new(colors)))),
        _ => Err(format!(
            "has {count} numbers a sample: give 1 (density) or 4 (red, green, blue, density)"
        )),
    }
}

impl RawForm {
    fn header(&self) -> RawHeader {
        RawHeader {
            size: self.size,
            channels: self.channels,
            element: self.r#type,
            order: self.order,
            skip: self.skip,
        }
    }
}

impl CloudForm {
    fn grid(&self, max_bytes: u64) -> Result<Grid, String> {
        let size = self.size.unwrap_or(CLOUD_SIZE);
        // Check the size against the memory limit
        let bytes = size.iter().try_fold(size_of::<f32>() as u64, |bytes, &side| {
            bytes.checked_mul(side as u64)
        });
        if bytes.is_none_or(|bytes| bytes > max_bytes) {
            return Err(format!(
                "its size is {size:?}, which takes more than the {max_bytes} bytes that are allowed: give fewer samples"
            ));
        }
        // Check the parameters of the noise
        let cloud = self.cloud();
        if !(1..=MAX_OCTAVES).contains(&cloud.octaves) {
            return Err(format!(
                "its octaves are {}: give 1 to {MAX_OCTAVES}",
                cloud.octaves
            ));
        }
        let is_positive = cloud.frequency > 0.0 && cloud.frequency.is_finite();
        let is_rough = cloud.roughness >= 0.0 && cloud.roughness.is_finite();
        if !(is_positive && is_rough && (0.0..1.0).contains(&cloud.threshold)) {
            return Err(
                "its frequency is not positive, its roughness negative, or its threshold not from 0 to less than 1: \
                 correct it"
                    .into(),
            );
        }
        cloud.bake(size).map_err(|fault| fault.to_string())
    }

    fn cloud(&self) -> Cloud {
        let shape = match self.shape {
            CloudShapeForm::Layer => CloudShape::Layer,
            CloudShapeForm::Puff => CloudShape::Puff,
            CloudShapeForm::Plume => CloudShape::Plume,
        };
        let usual = Cloud::SMOKE;
        Cloud {
            shape,
            frequency: self.frequency.unwrap_or(usual.frequency),
            octaves: self.octaves.unwrap_or(usual.octaves),
            roughness: self.roughness.unwrap_or(usual.roughness),
            threshold: self.threshold.unwrap_or(usual.threshold),
            seed: self.seed.unwrap_or(usual.seed),
        }
    }
}

impl FogForm {
    pub(super) fn fog(&self) -> Result<Fog, String> {
        // Fog without extinction needs no fine steps
        let usual = match self.extinction {
            extinction if extinction > 0.0 => 1.0 / (FOG_STEPS * extinction),
            _ => 1.0,
        };
        let [color, emission] = [self.color, self.emission].map(|color| color.0.map(f64::from));
        let step = self.step.unwrap_or(usual);
        Fog::new(self.extinction, color, emission, step).map_err(|fault| fault.to_string())
    }
}
