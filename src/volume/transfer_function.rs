//! Transfer functions: piecewise linear maps from grid values to colour, opacity and emission.
//!
//! Below the first node and above the last the function is constant. Opacity is either alpha(P) over a reference length
//! or an extinction per unit of length; emission is radiance per unit of length, so that flames need no opacity. Colour
//! is the single-scattering albedo, and contributes only where the medium attenuates.

use super::VolumeError;
use super::optical_depth::{OPAQUE, optical_depth};
use crate::numeric::{LANES, Lanes, Lanes3};

/// Medium properties at one grid value; between nodes all of them are interpolated linearly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TransferNode {
    /// Grid value of the node.
    pub value: f64,
    /// Opacity or extinction, in the unit that [`Thickness`] gives; not negative.
    pub thickness: f64,
    /// Linear RGB albedo: scattered light as a fraction of the light removed by extinction; not negative.
    pub color: [f64; 3],
    /// Linear RGB radiance emitted per unit of length; not negative.
    pub emission: [f64; 3],
}

/// Unit in which [`TransferNode::thickness`] is given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Thickness {
    /// Opacity in [0, 1] over this length, in world units.
    OpacityOver(f64),
    /// Extinction coefficient per world unit: the sum of absorption and scattering.
    Extinction,
}

/// Validated transfer function, as linear pieces.
#[derive(Clone, Debug, PartialEq)]
pub struct Transfer {
    thickness: Thickness,
    pieces: Vec<Piece>,
    emits: bool,
}

/// Number of interpolated fields: thickness, three of colour, three of emission.
const FIELDS: usize = 7;

/// Linear piece of the function, from `start` to the start of the next piece.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Piece {
    start: f64,
    /// Values of all fields at the start.
    base: [f64; FIELDS],
    /// Slope of each field per unit of the grid value.
    slope: [f64; FIELDS],
}

/// Optical properties of sixteen samples, integrated over their steps.
#[derive(Clone, Copy, Debug)]
pub(super) struct MediumSample {
    /// Optical depth of the step.
    pub(super) depth: Lanes<f64>,
    /// Optical depth times colour.
    pub(super) scattering: Lanes3<f64>,
    /// Step length times emission.
    pub(super) emission: Lanes3<f64>,
}

impl MediumSample {
    /// Vacuum: no depth, scattering or emission.
    pub(super) const NONE: MediumSample = MediumSample {
        depth: [0.0; LANES],
        scattering: [[0.0; LANES]; 3],
        emission: [[0.0; LANES]; 3],
    };
}

impl Transfer {
    /// Builds the function through `nodes`, whose values increase; there is at least one.
    ///
    /// Rejects values that do not increase, numbers that are negative or not finite, opacities above 1, and a reference
    /// length that is not positive.
    pub fn new(nodes: &[TransferNode], thickness: Thickness) -> Result<Transfer, VolumeError> {
        check(nodes, thickness)?;
        let mut pieces = Vec::with_capacity(nodes.len() + 1);
        // Start at a finite value: 0 times the distance from -infinity would be NaN.
        pieces.push(flat(f64::MIN, fields(&nodes[0])));
        // Add a linear piece between each pair of nodes
        for pair in nodes.windows(2) {
            let (base, end) = (fields(&pair[0]), fields(&pair[1]));
            let width = pair[1].value - pair[0].value;
            let slope = std::array::from_fn(|i| (end[i] - base[i]) / width);
            pieces.push(Piece {
                start: pair[0].value,
                base,
                slope,
            });
        }
        // Extend the last node's values to infinity
        let last = &nodes[nodes.len() - 1];
        pieces.push(flat(last.value, fields(last)));
        Ok(Transfer {
            thickness,
            emits: nodes.iter().any(|node| node.emission != [0.0; 3]),
            pieces,
        })
    }

    /// Builds the transfer function whose opacity alpha(P) over the length `over`, in world units, is the grid value
    /// clamped to [0, 1], with colour `color`.
    pub fn opacity(color: [f64; 3], over: f64) -> Result<Transfer, VolumeError> {
        let node = |value| TransferNode {
            value,
            thickness: value,
            color,
            emission: [0.0; 3],
        };
        Transfer::new(&[node(0.0), node(1.0)], Thickness::OpacityOver(over))
    }

    /// Returns the function for lengths that are `scale`, a power of two, times as large: exact.
    pub(super) fn rescaled(&self, scale: f64) -> Transfer {
        // Scale the reference length or the extinction
        let (thickness, thinner) = match self.thickness {
            Thickness::OpacityOver(length) => (Thickness::OpacityOver(length * scale), 1.0),
            Thickness::Extinction => (Thickness::Extinction, scale.recip()),
        };
        // Scale emission per unit of length
        let dimmer = scale.recip();
        let factors = [thinner, 1.0, 1.0, 1.0, dimmer, dimmer, dimmer];
        let scaled = |fields: &[f64; FIELDS]| std::array::from_fn(|i| fields[i] * factors[i]);
        let piece = |piece: &Piece| Piece {
            start: piece.start,
            base: scaled(&piece.base),
            slope: scaled(&piece.slope),
        };
        Transfer {
            thickness,
            emits: self.emits,
            pieces: self.pieces.iter().map(piece).collect(),
        }
    }

    /// Returns the maximum thickness over values in [low, high], and whether any of them emits.
    ///
    /// Exact: if both are absent, every value of the interval has exactly zero opacity and emission.
    pub fn maximum(&self, low: f64, high: f64) -> (f64, bool) {
        let (mut thickness, mut emits) = (0.0f64, false);
        for i in self.piece_of(low)..=self.piece_of(high) {
            let piece = &self.pieces[i];
            let end = self.pieces.get(i + 1).map_or(high, |next| high.min(next.start));
            // A linear function has its maximum at an end of the interval.
            for value in [low.max(piece.start), end] {
                let fields: [f64; FIELDS] = std::array::from_fn(|field| {
                    piece.base[field] + piece.slope[field] * (value - piece.start)
                });
                thickness = thickness.max(fields[0]);
                emits |= fields[4..].iter().any(|&x| x > 0.0);
            }
        }
        (thickness, emits)
    }

    /// Returns the index of the piece that contains `value`.
    fn piece_of(&self, value: f64) -> usize {
        self.pieces
            .partition_point(|piece| piece.start <= value)
            .saturating_sub(1)
    }

    /// Returns the optical depths of sixteen values over steps of `length` world units.
    #[inline(always)]
    pub(super) fn depth_lanes(&self, values: &Lanes<f64>, length: &Lanes<f64>) -> Lanes<f64> {
        let fields: [Lanes<f64>; 1] = self.field_lanes(values);
        self.depths(&fields[0], length)
    }

    /// Returns the medium sample of sixteen values over steps of `length` world units.
    #[inline(always)]
    pub(super) fn medium_lanes(&self, values: &Lanes<f64>, length: &Lanes<f64>) -> MediumSample {
        let mut medium = MediumSample::NONE;
        let colors: &[Lanes<f64>];
        let (with_emission, without_emission): ([Lanes<f64>; FIELDS], [Lanes<f64>; 4]);
        // Interpolate the fields, without emission if no node emits
        if self.emits {
            with_emission = self.field_lanes(values);
            for channel in 0..3 {
                for l in 0..LANES {
                    medium.emission[channel][l] = with_emission[4 + channel][l] * length[l];
                }
            }
            colors = &with_emission;
        } else {
            without_emission = self.field_lanes(values);
            colors = &without_emission;
        }
        // Compute optical depth and scattering
        medium.depth = self.depths(&colors[0], length);
        for channel in 0..3 {
            for l in 0..LANES {
                medium.scattering[channel][l] = colors[1 + channel][l] * medium.depth[l];
            }
        }
        medium
    }

    /// Interpolates the first `COUNT` fields at sixteen values.
    ///
    /// Neighbours along a ray have similar values: only the pieces between the lowest and the highest are visited.
    #[inline(always)]
    fn field_lanes<const COUNT: usize>(&self, values: &Lanes<f64>) -> [Lanes<f64>; COUNT] {
        let [low, high] = range(values);
        let pieces = &self.pieces[self.piece_of(low)..];
        let mut fields = [[0.0; LANES]; COUNT];
        for piece in pieces {
            if piece.start > high {
                break;
            }
            for i in 0..COUNT {
                for l in 0..LANES {
                    let here = piece.base[i] + piece.slope[i] * (values[l] - piece.start);
                    // A slope down to 0 may round below it.
                    let here = if here > 0.0 { here } else { 0.0 };
                    fields[i][l] = if values[l] >= piece.start {
                        here
                    } else {
                        fields[i][l]
                    };
                }
            }
        }
        fields
    }

    /// Converts thicknesses to optical depths over steps of `length` world units.
    #[inline(always)]
    fn depths(&self, thickness: &Lanes<f64>, length: &Lanes<f64>) -> Lanes<f64> {
        let mut depth = [0.0; LANES];
        match self.thickness {
            Thickness::Extinction => {
                for l in 0..LANES {
                    depth[l] = thickness[l] * length[l];
                }
            }
            Thickness::OpacityOver(reference) => {
                for l in 0..LANES {
                    // An opacity of 1 is opaque over any step, except one of length 0.
                    let here = length[l] / reference * optical_depth(thickness[l]);
                    let opaque = (thickness[l] >= 1.0) & (length[l] > 0.0);
                    depth[l] = if opaque { OPAQUE } else { here };
                }
            }
        }
        depth
    }
}

/// Returns the minimum and maximum of sixteen values by pairwise reduction.
#[inline(always)]
fn range(values: &Lanes<f64>) -> [f64; 2] {
    let (mut low, mut high) = (*values, *values);
    let mut half = LANES / 2;
    while half > 0 {
        for l in 0..half {
            low[l] = if low[l + half] < low[l] {
                low[l + half]
            } else {
                low[l]
            };
            high[l] = if high[l + half] > high[l] {
                high[l + half]
            } else {
                high[l]
            };
        }
        half /= 2;
    }
    [low[0], high[0]]
}

/// Returns a piece on which all fields are constant.
fn flat(start: f64, base: [f64; FIELDS]) -> Piece {
    Piece {
        start,
        base,
        slope: [0.0; FIELDS],
    }
}

/// Returns the fields of a node in the order of [`Piece::base`].
fn fields(node: &TransferNode) -> [f64; FIELDS] {
    let ([r, g, b], [er, eg, eb]) = (node.color, node.emission);
    [node.thickness, r, g, b, er, eg, eb]
}

/// Rejects nodes and reference lengths that are out of range.
fn check(nodes: &[TransferNode], thickness: Thickness) -> Result<(), VolumeError> {
    let wrong = |node: usize, fault: &'static str| Err(VolumeError::Transfer { node, fault });
    if nodes.is_empty() {
        return wrong(0, "is missing");
    }
    // Find the limit of the thickness, and check its unit
    let maximum = match thickness {
        Thickness::OpacityOver(reference) if !(reference > 0.0 && reference.is_finite()) => {
            return Err(VolumeError::Reference { reference });
        }
        Thickness::OpacityOver(_) => 1.0,
        Thickness::Extinction => f64::from(f32::MAX),
    };
    // Beyond the range of f32, differences could overflow.
    let in_range = |x: f64, maximum: f64| (0.0..=maximum).contains(&x);
    // Check each node
    for (i, node) in nodes.iter().enumerate() {
        let mut shades = node.color.into_iter().chain(node.emission);
        if !(node.value.abs() <= f64::from(f32::MAX)) {
            return wrong(i, "has a value that f32 cannot represent");
        }
        if i > 0 && !(nodes[i - 1].value < node.value) {
            return wrong(i, "is not above the one before");
        }
        if !in_range(node.thickness, maximum) {
            return wrong(
                i,
                "has an opacity outside 0 to 1 or an extinction that is negative or not finite",
            );
        }
        if !shades.all(|x| in_range(x, f64::from(f32::MAX))) {
            return wrong(i, "has a colour or emission that is negative or not finite");
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(value: f64, thickness: f64, red: f64, emission: f64) -> TransferNode {
        TransferNode {
            value,
            thickness,
            color: [red, 0.5, 0.25],
            emission: [emission, 0.0, 0.0],
        }
    }

    /// Returns a function that is clear up to 1, rises to 4 at 3, falls to 0 at 5, then is clear; it emits from 8 on,
    /// fully from 9.
    fn hill() -> Transfer {
        let nodes = [
            node(1.0, 0.0, 0.0, 0.0),
            node(3.0, 4.0, 1.0, 0.0),
            node(5.0, 0.0, 0.0, 0.0),
            node(8.0, 0.0, 0.0, 0.0),
            node(9.0, 0.0, 0.0, 2.0),
        ];
        Transfer::new(&nodes, Thickness::Extinction).unwrap()
    }

    #[test]
    fn fields_are_linear_between_nodes_and_constant_outside() {
        let mut values = [2.0; LANES];
        values[1..8].copy_from_slice(&[-1e30, 1.0, 3.0, 4.5, 5.0, 8.5, 1e30]);
        let medium = hill().medium_lanes(&values, &[0.5; LANES]);
        // Thickness 2, 0, 0, 4, 1, 0, 0, 0 over half a unit.
        assert_eq!(medium.depth[..8], [1.0, 0.0, 0.0, 2.0, 0.5, 0.0, 0.0, 0.0]);
        // Red is a quarter of the thickness here.
        assert_eq!(medium.scattering[0][..5], [0.5, 0.0, 0.0, 2.0, 0.125]);
        assert_eq!(medium.scattering[1][3], 1.0);
        assert_eq!(medium.emission[0][..8], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 1.0]);
        assert_eq!(hill().depth_lanes(&values, &[0.5; LANES]), medium.depth);
    }

    #[test]
    fn interval_maximum_is_at_nodes_or_ends() {
        let hill = hill();
        for (low, high, maximum) in [
            (-5.0, 1.0, 0.0),
            (-5.0, 1.0f64.next_up(), 2.0 * f64::EPSILON),
            (0.0, 2.0, 2.0),
            (0.0, 10.0, 4.0),
            (3.5, 6.0, 3.0),
            (5.0, 8.0, 0.0),
            (9.0, 90.0, 0.0),
        ] {
            assert_eq!(hill.maximum(low, high).0, maximum, "{low} {high}");
        }
        assert_eq!(hill.maximum(5.0, 8.0), (0.0, false));
        assert_eq!(hill.maximum(5.0, 8.5), (0.0, true));
        assert_eq!(hill.maximum(20.0, 30.0), (0.0, true));
    }

    #[test]
    fn interval_maximum_bounds_all_values_inside() {
        let hill = hill();
        let mut value = 0.5;
        while value < 12.0 {
            let [low, high] = [value, value + 0.037];
            let inside: Lanes<f64> = std::array::from_fn(|l| low + (high - low) * l as f64 / 15.0);
            let medium = hill.medium_lanes(&inside, &[1.0; LANES]);
            let (maximum, emits) = hill.maximum(low, high);
            assert!(medium.depth.iter().all(|&depth| depth <= maximum));
            assert!(emits || medium.emission[0] == [0.0; LANES]);
            value += 0.0173;
        }
    }

    #[test]
    fn opacities_refer_to_their_reference_length() {
        let transfer = Transfer::opacity([1.0; 3], 2.0).unwrap();
        let mut values = [0.3; LANES];
        values[1..4].copy_from_slice(&[1.0, 1.5, -3.0]);
        let whole = transfer.depth_lanes(&values, &[2.0; LANES]);
        let half = transfer.depth_lanes(&values, &[1.0; LANES]);
        // Optical depth -ln 0.7 over the whole length.
        assert!((whole[0] - 0.356_674_943_938_732_4).abs() <= 2.0 * f64::EPSILON);
        assert_eq!(half[0], 0.5 * whole[0]);
        assert_eq!((half[1], half[2], half[3]), (OPAQUE, OPAQUE, 0.0));
        assert_eq!(transfer.depth_lanes(&values, &[0.0; LANES]), [0.0; LANES]);
    }

    #[test]
    fn invalid_nodes_are_rejected_by_number() {
        let good = node(0.0, 0.5, 1.0, 0.0);
        let over = Thickness::OpacityOver(1.0);
        let refused = |nodes: &[TransferNode], thickness| Transfer::new(nodes, thickness).unwrap_err();
        assert!(matches!(
            refused(&[], over),
            VolumeError::Transfer { node: 0, .. }
        ));
        for bad in [
            node(0.0, 0.5, 1.0, 0.0),
            node(f64::NAN, 0.5, 1.0, 0.0),
            node(1e39, 0.5, 1.0, 0.0),
            node(1.0, 1.5, 1.0, 0.0),
            node(1.0, f64::NAN, 1.0, 0.0),
            node(1.0, 0.5, -1.0, 0.0),
            node(1.0, 0.5, 1.0, f64::INFINITY),
        ] {
            assert!(
                matches!(refused(&[good, bad], over), VolumeError::Transfer { node: 1, .. }),
                "{bad:?}"
            );
        }
        for length in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let error = refused(&[good], Thickness::OpacityOver(length));
            assert!(matches!(error, VolumeError::Reference { .. }));
        }
    }
}
