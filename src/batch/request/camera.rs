//! Choice of the camera that an image is rendered from.

use std::path::Path;

use super::error::RequestError;
use crate::scene::{Camera, Scene};

/// Returns the requested camera, looked up by name first and then by index; the first camera if none is requested.
///
/// # Errors
///
/// If the scene has no such camera; the message lists those that it has.
pub fn choose_camera<'s>(
    scene: &'s Scene,
    path: &Path,
    requested: Option<&str>,
) -> Result<&'s Camera, RequestError> {
    // Search by name first: a name may look like an index
    let cameras = &scene.cameras;
    let found = match requested {
        None => cameras.first(),
        Some(requested) => cameras
            .iter()
            .find(|camera| camera.name == requested)
            .or_else(|| cameras.get(requested.parse::<usize>().ok()?)),
    };
    found.ok_or_else(|| {
        let known: Vec<String> = cameras
            .iter()
            .enumerate()
            .map(|(number, camera)| format!("{number} `{}`", camera.name))
            .collect();
        RequestError::NoCamera {
            path: path.to_owned(),
            requested: requested.unwrap_or_default().to_owned(),
            known: match known.is_empty() {
                true => "none".into(),
                false => known.join(", "),
            },
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn camera_is_found_by_name_before_number() {
        let camera = |name: &str| Camera {
            name: name.into(),
            ..Camera::default()
        };
        let scene = Scene {
            cameras: ["front", "2", "top"].map(camera).into(),
            ..Scene::default()
        };
        let name = |requested| choose_camera(&scene, Path::new("a.glb"), requested).map(|c| c.name.clone());
        assert_eq!(name(None).unwrap(), "front");
        assert_eq!(name(Some("top")).unwrap(), "top");
        assert_eq!(name(Some("2")).unwrap(), "2");
        assert_eq!(name(Some("1")).unwrap(), "2");
        assert_eq!(
            name(Some("back")).unwrap_err().to_string(),
            "a.glb has no camera `back`: it has 0 `front`, 1 `2`, 2 `top`"
        );
    }
}
