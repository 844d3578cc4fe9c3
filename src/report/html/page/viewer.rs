//! Image viewer of a page: a slider between two images, or alternation in one position.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::elements::{escape, figure};
use crate::image::{LinearImage, ToneMap, png_bytes};

/// Image of a viewer with its texts.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Label of the image's button, of one or two words.
    pub name: &'a str,
    /// Description of the image, shown below it.
    pub words: &'a str,
    /// Linear image to display.
    pub image: &'a LinearImage,
    /// Tone mapping for the display.
    pub tone: ToneMap,
}

/// Returns an HTML image with embedded data, enlarged by `scale`.
///
/// # Errors
///
/// Returns an error if the image has more pixels than a PNG can store.
pub fn embedded_image(view: &View, scale: u32) -> std::io::Result<String> {
    // Embed the PNG as base64
    let png = STANDARD.encode(png_bytes(view.image, view.tone)?);
    Ok(format!(
        "<img width=\"{}\" height=\"{}\" alt=\"{}\" src=\"data:image/png;base64,{png}\">",
        scale * view.image.width,
        scale * view.image.height,
        escape(view.words)
    ))
}

/// Returns the HTML viewer of `views`; a slider or alternation compares the first two. Without a script, and on paper,
/// all are shown one below the other.
///
/// # Errors
///
/// Returns an error if an image has more pixels than a PNG can store.
pub fn viewer(views: &[View]) -> std::io::Result<String> {
    // List the modes: slider, alternation, each image
    let mut modes = vec![("slide", "slide"), ("turns", "in turns")];
    modes.extend(views.iter().map(|view| (view.name, view.name)));
    let buttons = modes.iter().enumerate().map(|(number, (value, word))| {
        let checked = if number == 0 { " checked" } else { "" };
        format!(
            "<label><input type=\"radio\" name=\"view\" value=\"{}\"{checked}> {}</label>\n",
            escape(value),
            escape(word)
        )
    });
    let buttons: String = buttons.collect();
    // Embed each image with the name of its mode
    let mut figures = String::new();
    for view in views {
        let shown = figure(&embedded_image(view, 1)?, &escape(view.words));
        figures += &shown.replacen(
            "<figure>",
            &format!("<figure data-view=\"{}\">", escape(view.name)),
            1,
        );
    }
    Ok(format!(
        "<div class=\"viewer\">\n<form>\n{buttons}<label><input type=\"checkbox\" name=\"pixels\"> pixel by pixel</label>\n\
         <input type=\"range\" name=\"cut\" min=\"0\" max=\"100\" step=\"0.1\" value=\"50\" \
         aria-label=\"Boundary between the images\">\n\
         </form>\n<div class=\"stage\">\n{figures}</div>\n</div>\n"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_image_has_a_button_and_a_figure() {
        let image = LinearImage::black(2, 1);
        let view = |name, words| View {
            name,
            words,
            image: &image,
            tone: ToneMap::default(),
        };
        let html = viewer(&[view("reference", "a <b>"), view("image", "b"), view("FLIP", "c")]).unwrap();
        for name in ["slide", "turns", "reference", "image", "FLIP"] {
            assert!(html.contains(&format!("value=\"{name}\"")), "{name} in {html}");
        }
        assert_eq!(html.matches("<figure data-view=").count(), 3);
        assert!(html.contains("a &lt;b&gt;") && !html.contains("<b>"), "{html}");
    }
}
