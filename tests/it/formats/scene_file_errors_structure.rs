//! Tests of scene files with invalid transforms, shapes, names, keys, groups, copies or motions, or that are no scene:
//! each is reported in one sentence with file, line, item and remedy, and the exit code is 2.

use std::fs;

use crate::support::cli_program::{refused, refused_in, whit};

const BALL: &str = "[[object]]\nshape = 'sphere'\n";

#[test]
fn singular_and_non_finite_transforms_are_rejected() {
    let with = |step: &str| format!("{BALL}transform = [\n  {{ translate = [0, 1, 0] }},\n  {step},\n]\n");
    refused(
        with("{ scale = 0 }"),
        ":5:",
        &["object 1.transform 2", "singular"],
    );
    refused(with("{ scale = [1, nan, 1] }"), ":5:", &["not finite"]);
    refused(with("{ translate = [inf, 0, 0] }"), ":5:", &["not finite"]);
    refused(
        with("{ matrix = [[1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0]] }"),
        ":5:",
        &["singular"],
    );
    refused(
        with("{ rotate = [0, 0, 0, 90] }"),
        ":5:",
        &["axis without length"],
    );
    refused(
        with("{ roatte = [0, 0, 1, 90] }"),
        ":5:",
        &["did you mean `rotate`?"],
    );
    refused(
        with("{ scale = 1, translate = [0, 0, 0] }"),
        ":5:",
        &["exactly one key"],
    );
}

#[test]
fn jointly_singular_transforms_are_rejected() {
    let text = "[[group.a.object]]\nshape = 'sphere'\ntransform = [{ scale = [1e-9, 1, 1] }]\n\
                [[object]]\ngroup = 'a'\ntransform = [{ scale = [1e-9, 1, 1] }]\n";
    refused(text, ":1:", &["group.a.object 1", "singular", "less extremely"]);
}

#[test]
fn invalid_shapes_are_rejected() {
    let shape = |shape: &str| format!("[[object]]\nshape = {shape}\n");
    refused(
        shape("{ sphere = { radius = 0 } }"),
        ":2:",
        &["radius 0", "positive"],
    );
    refused(shape("{ sphere = { radius = -1 } }"), ":2:", &["radius -1"]);
    refused(
        shape("{ torus = { minor_radius = 1 } }"),
        ":2:",
        &["`minor_radius`"],
    );
    refused(
        shape("{ quadric = { coefficients = [0,0,0,0,0,0,0,0,0,1], min = [0,0,0], max = [1,1,1] } }"),
        ":2:",
        &["not a surface"],
    );
    refused(
        shape("{ polyhedron = { half_spaces = [[1, 0, 0, 1]] } }"),
        ":2:",
        &["bounded"],
    );
    refused(
        shape("{ polyhedron = { } }"),
        ":2:",
        &["give `vertices` and `faces`"],
    );
    refused(shape("{ spere = { } }"), ":2:", &["did you mean `sphere`?"]);
    refused(
        shape("'spher'"),
        ":2:",
        &["no shape `spher`", "did you mean `sphere`?"],
    );
    refused(
        shape("7"),
        ":2:",
        &["object 1.shape", "is integer `7`", "a shape's name"],
    );
    refused(
        "[shape.cube]\nsphere = { }\n[[object]]\nshape = 'cube'\n",
        ":1:",
        &["choose another name"],
    );
}

#[test]
fn non_convex_polyhedra_and_polygons_are_rejected() {
    let dented = "[shape.star.polyhedron]\nvertices = [[0,0,0],[1,0,0],[0,1,0],[0,0,1],[0.1,0.1,0.1]]\n\
                  faces = [[0,2,1],[0,1,3],[0,3,2],[1,2,4],[2,3,4],[3,1,4]]\n[[object]]\nshape = 'star'\n";
    refused(dented, ":1:", &["shape.star", "not convex"]);
    let mesh = "[shape.arrow.mesh]\nvertices = [[0,0,0],[2,0,0],[0.5,0.5,0],[0,2,0]]\nfaces = [\n  [0, 1, 2],\n  [0, 1, 2, 3],\n]\n[[object]]\nshape = 'arrow'\n";
    refused(
        mesh,
        ":5:",
        &["shape.arrow.mesh.faces", "face 2 of the mesh is not convex"],
    );
}

#[test]
fn unknown_names_are_rejected() {
    let red = "[material.red]\n[material.blue]\n";
    refused(
        format!("{red}{BALL}material = 'rad'\n"),
        ":5:",
        &["object 1.material", "no material `rad`", "did you mean `red`?"],
    );
    refused(
        format!("{BALL}material = 'red'\n"),
        ":3:",
        &["add [material.red]"],
    );
    refused(
        "[[object]]\ngroup = 'x'\n",
        ":2:",
        &["no group `x`", "add [group.x]"],
    );
    refused(
        format!(
            "[texture.wood]\npattern = 'wood'\n[material.red]\nroughness = {{ texture = 'would' }}\n{BALL}"
        ),
        ":4:",
        &["material.red.roughness.texture", "did you mean `wood`?"],
    );
}

#[test]
fn duplicate_names_are_rejected() {
    refused(
        format!("[material.red]\n[material.red]\n{BALL}"),
        ":2:",
        &["given twice"],
    );
    refused(
        format!("{BALL}name = 'a'\n{BALL}name = 'a'\n"),
        ":6:",
        &["object 2.name", "`a` is already used"],
    );
    let camera = "[[camera]]\nname = 'c'\nfrom = [0, 0, 5]\nat = [0, 0, 0]\n";
    refused(
        format!("{camera}{camera}{BALL}"),
        ":6:",
        &["camera 2.name", "`c` is already used"],
    );
}

#[test]
fn unknown_keys_and_wrong_value_types_are_rejected() {
    refused(
        format!("ambeint = 1\n{BALL}"),
        ":1:1:",
        &["did you mean `ambient`?"],
    );
    refused(
        format!("[material.red]\nbase_colour = 1\n{BALL}"),
        ":2:1:",
        &["material.red", "did you mean `base_color`?"],
    );
    refused(
        format!("{BALL}colour = 1\n"),
        ":3:1:",
        &["`colour` is not known here", "give one of"],
    );
    refused(
        format!("[material.red]\nroughness = true\n{BALL}"),
        ":2:",
        &["material.red.roughness", "boolean", "a number"],
    );
    refused(
        format!("[[light]]\nkind = 'pint'\n{BALL}"),
        ":2:",
        &["did you mean `point`?"],
    );
    refused(
        format!("[[light]]\nintensity = 3\n{BALL}"),
        ":1:",
        &["lacks `kind`: add it"],
    );
    refused(
        format!("[camera]\nfrom = [0, 1]\nat = [0, 0, 0]\n{BALL}"),
        ":2:",
        &["camera.from", "has 2 elements"],
    );
    refused("object = 3\n", ":1:", &["is integer `3`", "a list"]);
    refused(
        format!("[output]\nspp = 0\n{BALL}"),
        ":1:",
        &["output", "its spp is 0"],
    );
    refused(format!("[output]\nsize = [0, 5]\n{BALL}"), ":1:", &["0 x 5"]);
    refused(
        format!("[output]\nsize = [-3, 5]\n{BALL}"),
        ":2:",
        &["output.size"],
    );
}

#[test]
fn missing_and_recursive_files_are_rejected() {
    refused(
        "[[object]]\ngltf = 'no.glb'\n",
        ":2:",
        &["no.glb", "check the path"],
    );
    refused(
        "[[object]]\ninclude = 'no.toml'\n",
        ":2:",
        &["no.toml", "check the path"],
    );
    refused("[[object]]\ninclude = 'bad.toml'\n", ":2:", &["includes itself"]);
    let folder = tempfile::tempdir().unwrap();
    fs::write(
        folder.path().join("b.toml"),
        format!("{BALL}[[object]]\ninclude = 'bad.toml'\n"),
    )
    .unwrap();
    let path = folder.path().join("bad.toml");
    fs::write(&path, "[[object]]\ninclude = 'b.toml'\n").unwrap();
    let run = whit(&["info", &path.display().to_string()]);
    assert_eq!(run.code, 2);
    assert!(
        run.stderr.contains("b.toml:4:") && run.stderr.contains("remove the include"),
        "{}",
        run.stderr
    );
    let run = whit(&["info", "no-such-scene.toml"]);
    assert_eq!((run.code, run.stderr.lines().count()), (2, 1), "{}", run.stderr);
}

#[test]
fn mutually_recursive_groups_are_rejected() {
    let text = "[[group.a.object]]\ngroup = 'b'\n[[group.b.object]]\ngroup = 'a'\n[[object]]\ngroup = 'a'\n";
    refused(
        text,
        ":4:",
        &[
            "group.b.object 1.group",
            "contain each other",
            "`a` in `b` in `a`",
        ],
    );
}

#[test]
fn excessive_numbers_of_copies_are_rejected() {
    refused(
        format!("{BALL}repeat = {{ count = [1000, 1000, 1000], step = [1, 1, 1] }}\n"),
        ":1:",
        &["more than 10000000 objects", "fewer copies"],
    );
    let most = u32::MAX;
    refused(
        format!("{BALL}repeat = {{ count = [{most}, {most}, {most}], step = [1, 1, 1] }}\n"),
        ":1:",
        &["fewer copies"],
    );
    refused(
        format!("{BALL}scatter = {{ count = 0, min = [0, 0, 0], max = [1, 1, 1] }}\n"),
        ":3:",
        &["makes no copy"],
    );
    // Ten times as many at each of nine levels.
    let mut text = String::from("[[group.g0.object]]\nshape = 'sphere'\n");
    for level in 1..=9 {
        let below = level - 1;
        text += &format!(
            "[[group.g{level}.object]]\ngroup = 'g{below}'\nrepeat = {{ count = [10, 1, 1], step = [1, 0, 0] }}\n"
        );
    }
    text += "[[object]]\ngroup = 'g9'\n";
    refused(text, ":24:", &["group.g8.object 1", "fewer copies"]);
}

#[test]
fn excessive_nesting_is_rejected() {
    let mut text = String::from("[[group.g0.object]]\nshape = 'sphere'\n");
    for level in 1..5000 {
        text += &format!("[[group.g{level}.object]]\ngroup = 'g{}'\n", level - 1);
    }
    text += "[[object]]\ngroup = 'g4999'\n";
    refused(text, ":", &["nested more than 64 levels"]);
    refused(
        format!("ambient = {}1{}\n", "[".repeat(100_000), "]".repeat(100_000)),
        ":1:",
        &["is not TOML"],
    );
}

#[test]
fn invalid_motions_are_rejected() {
    let moving = |end: &str| format!("{BALL}transform_end = [\n  {{ scale = 2 }},\n  {end},\n]\n");
    refused(
        moving("{ scale = [1, 0, 1] }"),
        ":5:",
        &["object 1.transform_end 2", "singular"],
    );
    refused(
        moving("{ scale = [1, -1, 1] }"),
        ":3:",
        &["object 1.transform_end", "mirror both or neither"],
    );
    let turning = "transform_end = [{ rotate = [0, 1, 0, 9] }]\n";
    let with_a_light = format!("{BALL}[[light]]\nkind = 'directional'\ndirection = [0, -1, 0]\n");
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("lamp.toml"), with_a_light).unwrap();
    refused_in(
        folder.path(),
        format!("[[object]]\ninclude = 'lamp.toml'\nlights = true\n{turning}"),
        ":1:",
        &["object 1", "lights", "remove"],
    );
    let with_a_volume = format!(
        "{BALL}[[volume]]\ncloud = {{ shape = 'puff', size = [4, 4, 4] }}\ntransfer = [{{ value = 0, extinction = 1 }}]\n"
    );
    fs::write(folder.path().join("smoke.toml"), with_a_volume).unwrap();
    let run_of = format!("[[object]]\ninclude = 'smoke.toml'\n{turning}");
    fs::write(folder.path().join("moving.toml"), run_of).unwrap();
    let run = whit(&["info", &folder.path().join("moving.toml").display().to_string()]);
    assert_eq!(run.code, 2);
    assert!(
        run.stderr.contains("smoke.toml:3:") && run.stderr.contains("volumes cannot"),
        "{}",
        run.stderr
    );
    let camera = |lines: &str| format!("{BALL}[camera]\nfrom = [0, 0, 5]\nat = [0, 0, 0]\n{lines}\n");
    refused(
        camera("shutter = [0.5, 0.25]"),
        ":3:",
        &["camera", "open from 0.5 to 0.25"],
    );
    refused(camera("shutter = [0, 1.5]"), ":3:", &["camera", "from 0 to 1"]);
    refused(camera("shutter = [0, nan]"), ":3:", &["camera", "from 0 to 1"]);
    refused(
        camera("end = { from = [0, 0, 0] }"),
        ":3:",
        &["camera", "at its `end`, has no viewing direction"],
    );
    refused(
        camera("end = { to = [0, 0, 0] }"),
        ":6:",
        &["camera.end.to", "not known here"],
    );
}

#[test]
fn non_scene_files_are_rejected() {
    refused("", ": ", &["nothing to render", "add an [[object]]"]);
    refused("# only a comment\n", ": ", &["add an [[object]]"]);
    refused([0u8, 159, 146, 150, 255], ": ", &["is not text"]);
    refused("glTF\0\0\0", ":1:", &["is not TOML"]);
    refused("[[object]\nshape = 'sphere'\n", ":1:", &["is not TOML"]);
    refused(
        "[[object]]\nname = 'nothing'\n",
        ":1:",
        &["exactly one of `shape`"],
    );
    refused(
        "[[object]]\nshape = 'plane'\n",
        ": ",
        &["no camera", "add a [camera]"],
    );
    refused(
        format!("{BALL}lights = true\n"),
        ":1:",
        &["no lights or cameras to import"],
    );
}
