//! Pictures of one size in one place: one slides over another, or they take turns.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::{escape, figure};
use crate::image::{LinearImage, ToneMap, png_bytes};

/// A picture of a viewer.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// What its button says, one word or two.
    pub name: &'a str,
    /// What it shows.
    pub words: &'a str,
    /// Its pixels.
    pub image: &'a LinearImage,
    /// How they become what is displayed.
    pub tone: ToneMap,
}

/// A picture that the page holds, `scale` times as large as it is.
///
/// # Errors
///
/// Where it has more pixels than a PNG.
pub fn picture(view: &View, scale: u32) -> std::io::Result<String> {
    let png = STANDARD.encode(png_bytes(view.image, view.tone)?);
    Ok(format!(
        "<img width=\"{}\" height=\"{}\" alt=\"{}\" src=\"data:image/png;base64,{png}\">",
        scale * view.image.width,
        scale * view.image.height,
        escape(view.words)
    ))
}

/// A viewer of `views`, the first two of which can be slid over each other and take turns. Without a script, and on
/// paper, all are shown one below the other.
///
/// # Errors
///
/// Where a picture has more pixels than a PNG.
pub fn viewer(views: &[View]) -> std::io::Result<String> {
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
    let mut figures = String::new();
    for view in views {
        let shown = figure(&picture(view, 1)?, &escape(view.words));
        figures += &shown.replacen(
            "<figure>",
            &format!("<figure data-view=\"{}\">", escape(view.name)),
            1,
        );
    }
    Ok(format!(
        "<div class=\"viewer\">\n<form>\n{buttons}<label><input type=\"checkbox\" name=\"pixels\"> pixel by pixel</label>\n\
         <input type=\"range\" name=\"cut\" min=\"0\" max=\"100\" step=\"0.1\" value=\"50\" aria-label=\"Where one picture ends\">\n\
         </form>\n<div class=\"stage\">\n{figures}</div>\n</div>\n"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_picture_has_a_button_and_a_place() {
        let image = LinearImage::black(2, 1);
        let view = |name, words| View {
            name,
            words,
            image: &image,
            tone: ToneMap::default(),
        };
        let html = viewer(&[
            view("reference", "a <b>"),
            view("picture", "b"),
            view("FLIP", "c"),
        ])
        .unwrap();
        for name in ["slide", "turns", "reference", "picture", "FLIP"] {
            assert!(html.contains(&format!("value=\"{name}\"")), "{name} in {html}");
        }
        assert_eq!(html.matches("<figure data-view=").count(), 3);
        assert!(html.contains("a &lt;b&gt;") && !html.contains("<b>"), "{html}");
    }
}
