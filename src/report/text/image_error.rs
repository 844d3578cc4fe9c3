//! Line on the estimated error of a finished image: `whit render`.

use std::fmt;

use crate::render::ImageError;
use crate::report::format::significant;

/// Estimated error of an image as one line.
#[derive(Clone, Copy, Debug)]
pub struct ImageErrorText<'a>(pub &'a ImageError);

impl fmt::Display for ImageErrorText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let ImageError {
            rmse,
            interval: [low, high],
            pixels,
            samples_of_half_error,
            ..
        } = self.0;
        if *high == 0.0 {
            return write!(f, "estimated error: none, from {pixels} pixels");
        }
        if *rmse == 0.0 {
            let high = significant(*high, 2);
            return write!(
                f,
                "estimated error: RMSE at most {high} of displayed values, from {pixels} pixels"
            );
        }
        write!(
            f,
            "estimated error: RMSE {} ({} to {}) of displayed values, from {pixels} pixels; half of it takes ",
            significant(*rmse, 2),
            significant(*low, 2),
            significant(*high, 2)
        )?;
        match samples_of_half_error {
            Some(factor) => write!(f, "{factor:.1} times the samples"),
            // The rate of random samples is the slowest
            None => write!(f, "at most 4 times the samples"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_has_error_and_price() {
        let mut error = ImageError {
            rmse: 0.01234,
            interval: [0.01, 0.0139],
            stops: 0.0,
            pixels: 4096,
            samples_of_half_error: Some(2.64),
        };
        assert_eq!(
            ImageErrorText(&error).to_string(),
            "estimated error: RMSE 0.012 (0.010 to 0.014) of displayed values, from 4096 pixels; half of it takes 2.6 \
             times the samples"
        );
        error.samples_of_half_error = None;
        assert!(
            ImageErrorText(&error)
                .to_string()
                .ends_with("at most 4 times the samples")
        );
        (error.rmse, error.interval) = (0.0, [0.0, 0.002]);
        assert_eq!(
            ImageErrorText(&error).to_string(),
            "estimated error: RMSE at most 0.0020 of displayed values, from 4096 pixels"
        );
        error.interval = [0.0; 2];
        assert_eq!(
            ImageErrorText(&error).to_string(),
            "estimated error: none, from 4096 pixels"
        );
    }
}
