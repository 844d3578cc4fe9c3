//! The manual, one page per topic, as `whit help TOPIC` prints it.

/// A page of the manual.
#[derive(Clone, Copy, Debug)]
pub struct Topic {
    /// Word that selects the page, as in `whit help scene-files`.
    pub name: &'static str,
    /// The page in Markdown, at most 80 columns wide.
    pub text: &'static str,
}

impl Topic {
    /// Returns the page's title, without the mark of a heading.
    pub fn title(&self) -> &'static str {
        self.text
            .lines()
            .next()
            .unwrap_or_default()
            .trim_start_matches("# ")
    }
}

/// Returns the page of the topic called `name`, if there is one.
pub fn topic(name: &str) -> Option<Topic> {
    TOPICS.iter().copied().find(|topic| topic.name == name)
}

/// Defines [`TOPICS`], and a documented module for each page so that rustdoc shows it.
macro_rules! topics {
    ($($module:ident $name:literal $file:literal)*) => {
        /// All pages, in the order of the README.
        pub const TOPICS: &[Topic] = &[$(Topic { name: $name, text: include_str!($file) }),*];

        $(#[doc = include_str!($file)] pub mod $module {})*
    };
}

topics! {
    render "render" "render.md"
    scene_files "scene-files" "scene-files.md"
    gltf "gltf" "gltf.md"
    light "light" "light.md"
    materials "materials" "materials.md"
    volumes "volumes" "volumes.md"
    effects "effects" "effects.md"
    sampling "sampling" "sampling.md"
    images "images" "images.md"
    stats "stats" "stats.md"
    precision "precision" "precision.md"
    verify "verify" "verify.md"
    cost "cost" "cost.md"
    batch "batch" "batch.md"
    bench "bench" "bench.md"
    compare "compare" "compare.md"
    embree "embree" "embree.md"
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns of the narrowest terminal that a page must fit.
    const COLUMNS: usize = 80;

    #[test]
    fn pages_fit_a_terminal_and_begin_with_a_title() {
        for topic in TOPICS {
            assert!(topic.text.starts_with("# "), "{}", topic.name);
            assert!(!topic.title().is_empty(), "{}", topic.name);
            for line in topic.text.lines() {
                assert!(line.chars().count() <= COLUMNS, "{}: {line}", topic.name);
            }
        }
    }

    #[test]
    fn pages_refer_to_topics_that_exist() {
        for page in TOPICS {
            for (at, _) in page.text.match_indices("whit help ") {
                let name: String = page.text[at + "whit help ".len()..]
                    .chars()
                    .take_while(|c| c.is_ascii_lowercase() || *c == '-')
                    .collect();
                assert!(topic(&name).is_some(), "{} refers to {name}", page.name);
            }
        }
    }
}
