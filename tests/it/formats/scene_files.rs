//! Tests of valid scene files: the examples, the schema, groups, copies, includes and the command line.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::cli_program::{first_light, whit};
use glam::DVec3;
use whit::gltf::LoadOptions;
use whit::scene::{Light, LightKind, Scene};
use whit::scene_file::{self, SceneFile};

fn load(path: &Path) -> SceneFile {
    scene_file::load(path, &LoadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

/// Loads the scene with this text, in a folder with the files `others`.
fn load_text(text: &str, others: &[(&str, &str)]) -> SceneFile {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in others {
        fs::write(folder.path().join(name), text).unwrap();
    }
    let path = folder.path().join("scene.toml");
    fs::write(&path, text).unwrap();
    load(&path)
}

fn origins(scene: &Scene) -> Vec<DVec3> {
    scene
        .instances
        .iter()
        .map(|i| i.world_from_object().translation)
        .collect()
}

fn examples() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let mut paths: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "toml"))
        .filter(|path| !path.to_string_lossy().ends_with(".jobs.toml"))
        .collect();
    paths.sort();
    paths
}

#[test]
fn every_example_loads_and_describes_itself() {
    assert!(examples().len() >= 3);
    for path in examples() {
        let text = fs::read_to_string(&path).unwrap();
        let comment: Vec<&str> = text.lines().take_while(|line| line.starts_with('#')).collect();
        assert!(comment.len() >= 2, "{}", path.display());
        assert!(
            comment.iter().any(|line| line.contains("Effects:")),
            "{}",
            path.display()
        );
        assert!(load(&path).scene.validate().is_ok());
    }
}

#[test]
fn schema_in_the_repository_is_current() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/schema.json");
    let stored = fs::read_to_string(path).unwrap();
    assert!(
        stored == scene_file::json_schema(),
        "write it anew: whit schema > scenes/schema.json"
    );
    assert_eq!(whit(&["schema"]).stdout, stored);
}

#[test]
fn schema_rejects_unknown_keys_like_the_reader() {
    let schema: serde_json::Value = serde_json::from_str(&scene_file::json_schema()).unwrap();
    assert_eq!(schema["additionalProperties"], false);
    let definitions = schema["definitions"].as_object().unwrap();
    for form in [
        "ObjectForm",
        "MaterialForm",
        "LightForm",
        "CameraForm",
        "TextureForm",
    ] {
        assert_eq!(definitions[form]["additionalProperties"], false, "{form}");
    }
    assert_eq!(
        definitions["LightForm"]["properties"]["intensity"]["default"],
        1.0
    );
}

#[test]
fn nested_groups_and_copies_flatten_in_written_order() {
    let scene = load_text(
        "[[group.a.object]]\nshape = 'sphere'\nrepeat = { count = [2, 1, 1], step = [1, 0, 0] }\n\
         [[group.b.object]]\ngroup = 'a'\ntransform = [{ scale = 2 }, { translate = [0, 5, 0] }]\n\
         [[object]]\ngroup = 'b'\nrepeat = { count = [1, 1, 2], step = [0, 0, 7] }\n",
        &[],
    );
    // In a: x = 0, 1. Doubled: 0, 2, moved up by 5; then once at z = 0 and once at z = 7.
    let expected = [[0.0, 5.0, 0.0], [2.0, 5.0, 0.0], [0.0, 5.0, 7.0], [2.0, 5.0, 7.0]];
    assert_eq!(origins(&scene.scene), expected.map(DVec3::from));
    assert_eq!((scene.group_count, scene.scene.geometries.len()), (2, 1));
}

#[test]
fn motions_of_groups_and_members_compose() {
    let scene = load_text(
        "[[group.a.object]]\nshape = 'sphere'\ntransform = [{ translate = [1, 0, 0] }]\n\
         transform_end = [{ translate = [3, 0, 0] }]\n[[group.a.object]]\nshape = 'cube'\n\
         [[object]]\ngroup = 'a'\ntransform_end = [{ rotate = [0, 0, 1, 90] }]\n\
         [[object]]\nshape = 'cube'\ntransform = [{ scale = 2 }]\ntransform_end = [{ scale = 2 }]\n\
         [camera]\nfrom = [0, 0, 9]\nat = [0, 0, 0]\nend = { at = [1, 0, 0] }\nshutter = [0.25, 0.5]\n",
        &[],
    )
    .scene;
    let ends = scene.instances[0].motion().unwrap().ends();
    // The start is (1, 0, 0); the end is (3, 0, 0), rotated to (0, 3, 0).
    assert_eq!(ends[0].translation, DVec3::X);
    assert!((ends[1].translation - 3.0 * DVec3::Y).length() < 1e-15);
    let moving: Vec<bool> = scene.instances.iter().map(|i| i.is_moving()).collect();
    assert_eq!(moving, [true, true, false]);
    let camera = &scene.cameras[0];
    assert_eq!((camera.shutter.open, camera.shutter.close), (0.25, 0.5));
    let end = camera.world_from_camera_end.unwrap();
    assert_eq!(end.translation, camera.world_from_camera.translation);
    assert!((end.matrix3.z_axis - DVec3::new(-1.0, 0.0, 9.0).normalize()).length() < 1e-15);
}

#[test]
fn far_moving_scene_is_normalised_with_motion_and_camera() {
    let scene = load_text(
        "[[object]]\nshape = 'cube'\ntransform = [{ translate = [1e7, 0, 0] }]\n\
         transform_end = [{ translate = [1.0000004e7, 0, 0] }]\n\
         [camera]\nfrom = [1e7, 0, 9]\nat = [1e7, 0, 0]\nend = { from = [1e7, 3, 9] }\n",
        &[],
    )
    .scene;
    // The box around the whole motion, from 1e7 - 1 to 1e7 + 5, is moved to within some of its sizes of the origin.
    let bounds = scene.bounds();
    assert!(
        (bounds.extent().x - 6.0).abs() < 1e-6 && bounds.magnitude() < 60.0,
        "{bounds:?}"
    );
    let [from, to] = scene.instances[0]
        .motion()
        .unwrap()
        .ends()
        .map(|map| map.translation);
    assert_eq!(to - from, DVec3::new(4.0, 0.0, 0.0));
    let camera = &scene.cameras[0];
    let eyes = [camera.world_from_camera, camera.world_from_camera_end.unwrap()].map(|map| map.translation);
    assert_eq!(
        eyes.map(|eye| eye - from),
        [DVec3::new(0.0, 0.0, 9.0), DVec3::new(0.0, 3.0, 9.0)]
    );
}

#[test]
fn group_material_applies_to_members_without_one() {
    let scene = load_text(
        "[material.red]\n[material.blue]\n\
         [[group.a.object]]\nshape = 'sphere'\nmaterial = 'red'\n[[group.a.object]]\nshape = 'cube'\n\
         [[object]]\ngroup = 'a'\nmaterial = 'blue'\n[[object]]\ngroup = 'a'\n",
        &[],
    )
    .scene;
    let names: Vec<&str> = (scene.instances.iter())
        .map(|i| &*scene.materials[i.material as usize].name)
        .collect();
    assert_eq!(names, ["red", "blue", "red", "default"]);
}

#[test]
fn include_keeps_names_and_imports_lights_on_request() {
    let other = "[material.red]\nbase_color = 0.25\n[[light]]\nkind = 'point'\nposition = [1, 0, 0]\n\
                 [[object]]\nshape = 'sphere'\nmaterial = 'red'\n";
    let main = "[material.red]\nbase_color = 0.75\n[[object]]\nshape = 'sphere'\nmaterial = 'red'\n\
                [[object]]\ninclude = 'other.toml'\nlights = true\ntransform = [{ translate = [0, 3, 0] }]\n\
                [[object]]\ninclude = 'other.toml'\n";
    let file = load_text(main, &[("other.toml", other)]);
    let scene = &file.scene;
    assert_eq!(
        (scene.instances.len(), scene.lights.len(), file.include_count),
        (3, 1, 1)
    );
    let color = |i: usize| scene.materials[scene.instances[i].material as usize].base_color[0];
    assert_eq!((color(0), color(1)), (0.75, 0.25));
    let whit::scene::LightKind::Point { position, .. } = scene.lights[0].kind else {
        unreachable!()
    };
    assert_eq!(position, DVec3::new(1.0, 3.0, 0.0));
}

#[test]
fn gltf_import_uses_its_transform_and_material() {
    let text = format!(
        "[material.red]\n[[object]]\ngltf = '{0}'\n[[object]]\ngltf = '{0}'\nmaterial = 'red'\n\
         transform = [{{ translate = [0, 100, 0] }}]\n",
        first_light()
    );
    let file = load_text(&text, &[]);
    let alone = whit::gltf::load(Path::new(&first_light()), &LoadOptions::default()).unwrap();
    let count = alone.instances.len();
    assert_eq!(file.scene.instances.len(), 2 * count);
    assert_eq!(file.scene.geometries.len(), alone.geometries.len());
    let red = file.scene.materials.iter().position(|m| m.name == "red").unwrap() as u32;
    assert!(file.scene.instances[count..].iter().all(|i| i.material == red));
    assert!(file.scene.instances[..count].iter().all(|i| i.material != red));
    let tall = file.scene.bounds().extent().y - alone.bounds().extent().y;
    assert!((tall - 100.0).abs() < 1e-3, "{tall}");
}

#[test]
fn emissive_parts_light_the_scene_on_request() {
    // Both levels use equal names: the group's own override for its ball takes precedence over the object's for the
    // group.
    let text = "[material.neon]\nemission = [3, 2, 1]\n[material.dull]\n\
                [[group.sign.object]]\nname = 'ball'\nshape = 'sphere'\nmaterial = 'neon'\nlamp = 9\n\
                [[group.sign.object]]\nname = 'pole'\nshape = 'cylinder'\nmaterial = 'dull'\n\
                [[group.sign.object]]\nname = 'pane'\nshape = 'quad'\nmaterial = 'neon'\n\
                [[group.sign.object]]\nname = 'ground'\nshape = 'plane'\nmaterial = 'neon'\n\
                [[object]]\nname = 'sign'\ngroup = 'sign'\nlamp = true\nrepeat = { count = [2, 1, 1], step = [4, 0, 0] }\n\
                [[object]]\nname = 'ring'\nshape = 'torus'\nmaterial = 'neon'\nlamp = false\n";
    let scene = load_text(text, &[]).scene;
    let area_lights: Vec<(&str, u32)> = scene
        .lights
        .iter()
        .map(|light| match light.kind {
            LightKind::Area { samples, .. } => (&light.name[..], samples),
            _ => unreachable!(),
        })
        .collect();
    assert_eq!(area_lights, [("ball", 9), ("pane", 4), ("ball", 9), ("pane", 4)]);
    for light in &scene.lights {
        assert_eq!(light.intensity, [3.0, 2.0, 1.0]);
        let instance = &scene.instances[light.emissive_instance().unwrap() as usize];
        assert_eq!(*instance.name, *light.name);
    }
    let warning = "ground of sign emits but lights nothing, because a plane, polyhedron or quadric cannot be an area \
                light: give another shape or a mesh";
    assert_eq!(scene.warnings, [warning]);
}

#[test]
fn area_lights_of_imports_are_their_emissive_parts() {
    let knot = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/meshes/neon_knot.glb");
    let other = format!("[[object]]\ngltf = '{knot}'\nlamp = 2\n");
    let text = format!(
        "[[object]]\ngltf = '{knot}'\n[[object]]\ngltf = '{knot}'\nlamp = 3\n\
         transform = [{{ translate = [0, 100, 0] }}, {{ scale = [-1, 1, 1] }}]\n[[object]]\ninclude = 'other.toml'\n"
    );
    let scene = load_text(&text, &[("other.toml", &other)]).scene;
    let area_lights: Vec<Option<u32>> = scene.lights.iter().map(Light::emissive_instance).collect();
    assert_eq!(area_lights, [Some(1), Some(2)]);
    // A triangle of zero area after its transform is removed, and the object with it: the index of the other light
    // follows.
    let text = "[material.neon]\nemission = 1\n\
                [[object]]\nshape = { mesh = { vertices = [[0, 0, 0], [1e-30, 0, 0], [0, 1e-30, 0]], faces = [[0, 1, 2]] } }\n\
                material = 'neon'\ntransform = [{ translate = [1, 1, 1] }]\n\
                [[object]]\nshape = 'quad'\nmaterial = 'neon'\nlamp = true\n";
    let scene = load_text(text, &[]).scene;
    assert_eq!(
        (scene.instances.len(), scene.lights[0].emissive_instance()),
        (1, Some(0))
    );
}

#[test]
fn scattered_copies_are_reproducible() {
    let text = "[[object]]\nshape = 'cube'\n\
                scatter = { count = 10000, min = [-5, 0, -5], max = [5, 1, 5], turn = [0, 1, 0], scale = [0.1, 0.2] }\n";
    let [one, other] = [(); 2].map(|()| origins(&load_text(text, &[]).scene));
    assert_eq!(one.len(), 10_000);
    assert_eq!(one, other);
    assert!(one.iter().all(|p| p.x.abs() <= 5.0 && (0.0..=1.0).contains(&p.y)));
    let mean = one.iter().sum::<DVec3>() / 1e4;
    // Ten thousand uniform positions of width 10: the mean has an error of 10 / sqrt(12 * 10^4) = 0.03; the bound is
    // five times that.
    assert!(
        mean.x.abs() < 0.15 && mean.z.abs() < 0.15 && (mean.y - 0.5).abs() < 0.015,
        "{mean}"
    );
}

#[test]
fn mesh_with_a_solid_pattern_keeps_its_object_space() {
    let text = |space: &str| {
        format!(
            "[shape.s.mesh]\nvertices = [[0,0,0],[1,0,0],[0,1,0]]\nuv = [[0,0],[1,0],[0,1]]\nfaces = [[0,1,2]]\n\
             [texture.t]\npattern = 'wood'\nspace = '{space}'\n[material.m]\nbase_color = {{ texture = 't' }}\n\
             [[object]]\nshape = 's'\nmaterial = 'm'\ntransform = [{{ translate = [0, 0, 2] }}]\n"
        )
    };
    assert!(!load_text(&text("object"), &[]).scene.instances[0].is_identity());
    assert!(load_text(&text("uv"), &[]).scene.instances[0].is_identity());
}

#[test]
fn command_line_overrides_image_settings() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let text = "[output]\nsize = [6, 4]\nspp = 2\ndepth = 3\n[[object]]\nshape = 'sphere'\n";
    fs::write(at("a.toml"), text).unwrap();
    let stats = |more: &[&str]| -> serde_json::Value {
        let (scene, image, stats) = (at("a.toml"), at("a.png"), at("a.json"));
        let run = whit(&[&["render", &scene, "-o", &image, "--stats", &stats], more].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
        serde_json::from_slice(&fs::read(stats).unwrap()).unwrap()
    };
    let own = stats(&[]);
    assert_eq!(
        (own["image"]["width"].as_u64(), own["image"]["height"].as_u64()),
        (Some(6), Some(4))
    );
    assert_eq!((own["spp"].as_u64(), own["depth"].as_u64()), (Some(2), Some(3)));
    let other = stats(&["--size", "3x3", "--spp", "1", "--depth", "0"]);
    assert_eq!(other["image"]["width"], 3);
    assert_eq!(
        (other["spp"].as_u64(), other["depth"].as_u64()),
        (Some(1), Some(0))
    );
}

/// Returns the bytes of the EXR that `whit render` writes for this text with these flags.
fn rendered(text: &str, flags: &[&str]) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    fs::write(at("a.toml"), text).unwrap();
    let run = whit(
        &[
            &["render", &at("a.toml"), "-o", &at("a.exr"), "--backend", "bsp"],
            flags,
        ]
        .concat(),
    );
    assert_eq!(run.code, 0, "{}", run.stderr);
    fs::read(at("a.exr")).unwrap()
}

#[test]
fn file_sets_sampling_and_filter_like_the_flags() {
    let with = |output: &str| {
        format!(
            "[output]\nsize = [9, 7]\nspp = 4\n{output}\n[material.m]\nemission = 1\n\
             [[object]]\nshape = 'sphere'\nmaterial = 'm'\n"
        )
    };
    let plain = with("");
    let tent = "pattern = 'r2'\nfilter = 'tent'\nfilter_radius = 1.5";
    let flags = ["--pattern", "r2", "--filter", "tent", "--filter-radius", "1.5"];
    let of_file = rendered(&with(tent), &[]);
    assert!(of_file == rendered(&plain, &flags));
    assert!(of_file != rendered(&plain, &flags[..4]), "the radius counts");
    assert!(of_file != rendered(&plain, &flags[2..]), "the pattern counts");
    // Flags override; the radius belongs to its filter, and a radius alone applies to the file's filter.
    assert!(rendered(&with(tent), &["--pattern", "sobol", "--filter", "box"]) == rendered(&plain, &[]));
    let wider = ["--pattern", "r2", "--filter", "tent", "--filter-radius", "2"];
    assert!(rendered(&with(tent), &wider[4..]) == rendered(&plain, &wider));
}

#[test]
fn file_sets_the_number_of_wavelengths() {
    let text = |output: &str| {
        format!(
            "ambient = 1\nbackground = {{ horizon = 1, up = 0 }}\n[output]\nsize = [9, 7]\nspp = 1\n{output}\n\
             [material.m]\nglass = 'n-sf10'\n[[object]]\nshape = 'sphere'\nmaterial = 'm'\n"
        )
    };
    let three = rendered(&text("wavelengths = 3"), &[]);
    assert!(three == rendered(&text(""), &["--wavelengths", "3"]));
    assert!(three != rendered(&text(""), &[]));
    assert!(rendered(&text("wavelengths = 3"), &["--wavelengths", "16"]) == rendered(&text(""), &[]));
}

#[test]
fn filter_and_adaptive_sampling_conflict_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let text = "[output]\nsize = [9, 7]\nspp = 32\nfilter = 'mitchell'\n[[object]]\nshape = 'sphere'\n";
    fs::write(at("a.toml"), text).unwrap();
    let (scene, image) = (at("a.toml"), at("a.png"));
    let flags = ["render", &scene, "-o", &image, "--adaptive", "0.01"];
    let run = whit(&flags);
    assert_eq!(run.code, 2, "{}", run.stderr);
    assert!(run.stderr.contains("`--filter box`"), "{}", run.stderr);
    assert_eq!(whit(&[&flags[..], &["--filter", "box"]].concat()).code, 0);
}

#[test]
fn info_lists_materials_media_shapes_and_groups() {
    let path = examples()
        .into_iter()
        .find(|p| p.ends_with("ellipsoids.toml"))
        .unwrap();
    let run = whit(&["info", &path.display().to_string()]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    for words in [
        "1041 sphere",
        "5 groups",
        "`rose`, metallic-roughness",
        "roughness 0.4",
    ] {
        assert!(run.stdout.contains(words), "{words} in {}", run.stdout);
    }
    let path = examples()
        .into_iter()
        .find(|p| p.ends_with("whitted_1980.toml"))
        .unwrap();
    let run = whit(&["info", &path.display().to_string()]);
    for words in [
        "`mirror`, lecture",
        "interior n = 1.5000",
        "textures on BaseColor",
    ] {
        assert!(run.stdout.contains(words), "{words} in {}", run.stdout);
    }
}
