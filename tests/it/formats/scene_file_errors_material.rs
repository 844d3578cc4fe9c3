//! Tests of scene files with invalid materials, textures, images, lights or volumes: each is reported in one sentence
//! with file, line, item and remedy, and the exit code is 2.

use crate::support::cli_program::refused;

const BALL: &str = "[[object]]\nshape = 'sphere'\n";

#[test]
fn invalid_subsurface_scattering_is_rejected() {
    let material = |text: &str| format!("[material.m]\nroughness = 0.5\n{text}\n{BALL}");
    refused(
        material("subsurface = 'chalk'"),
        ":3:",
        &[
            "material.m.subsurface",
            "`chalk` is not a measured material",
            "apple",
            "wholemilk",
        ],
    );
    refused(
        material("\n[material.m.subsurface]\nscale = 0.1\npreset = 'chalk'"),
        ":6:",
        &["material.m.subsurface.preset", "give one of apple"],
    );
    refused(
        material("transmission = 1\nsubsurface = 'marble'"),
        ":4:",
        &["give either `transmission` or one of `subsurface` and `translucency`"],
    );
    refused(
        material("subsurface = 3"),
        ":3:",
        &["the name of a measured material or a table"],
    );
    refused(
        material("subsurface = { scattering = 1, absorbtion = 2 }"),
        ":3:",
        &["did you mean `absorption`?"],
    );
    refused(
        material("subsurface = { scattering = 1, absorption = -2 }"),
        ":3:",
        &["negative"],
    );
    refused(
        material("subsurface = { reflectance = 0.5, mean_free_path = 0 }"),
        ":3:",
        &["mean free path of the red channel is 0"],
    );
    refused(
        material("translucency = -1"),
        ":3:",
        &["material.m.translucency", "outside [0, 1]"],
    );
    refused(
        material("subsurface = 'marble'").replace("'sphere'", "'plane'\nmaterial = 'm'")
            + "[camera]\nfrom = [0, 0, 1]\nat = [0, 0, 0]\n",
        ":",
        &["a plane is unbounded", "give a disk or a quad"],
    );
    refused(
        material("subsurface = 'marble'").replace(
            "'sphere'",
            "'sphere'\nmaterial = 'm'\ntransform_end = [{ translate = [1, 0, 0] }]",
        ) + "[camera]\nfrom = [0, 0, 5]\nat = [0, 0, 0]\n",
        ":",
        &["moves", "has subsurface scattering", "remove the motion"],
    );
}

#[test]
fn invalid_materials_are_rejected() {
    let material = |text: &str| format!("[material.m]\n{text}\n{BALL}");
    refused(
        material("transmission = 1\nior = 40"),
        ":1:",
        &["material.m", "index of refraction", "between 1/16 and 16"],
    );
    refused(material("ior = 0"), ":1:", &["index of refraction"]);
    refused(material("ior = nan"), ":1:", &["index of refraction"]);
    refused(material("speed = 0"), ":1:", &["fraction of the speed of light"]);
    refused(
        material("base_color = [1, -0.5, 0]"),
        ":2:",
        &["material.m.base_color", "negative"],
    );
    refused(material("base_color = 2"), ":1:", &["outside [0, 1]"]);
    refused(material("emission = -1"), ":2:", &["negative"]);
    refused(material("roughness = 1.5"), ":1:", &["outside [0, 1]"]);
    refused(
        material("rough_rays = 300"),
        ":1:",
        &["material.m", "its `rough_rays` is 300: give 0 to 256"],
    );
    refused(material("rough_rays = -1"), ":2:", &["rough_rays"]);
    refused(material("rough_rays = 2.5"), ":2:", &["rough_rays"]);
    refused(
        material("exponent = 3"),
        ":1:",
        &["\"metallic-roughness\" has no `exponent`"],
    );
    refused(format!("ambient = -1\n{BALL}"), ":1:", &["negative"]);
    refused(
        format!("[[light]]\nkind = 'point'\nposition = [0, 0, 0]\ncolor = '#ff00'\n{BALL}"),
        ":4:",
        &["light 1.color", "is not a colour"],
    );
}

#[test]
fn invalid_image_settings_are_rejected() {
    let with = |line: &str| format!("[output]\n{line}\n{BALL}");
    refused(
        with("filter_radius = 2"),
        ":1:",
        &["output", "is a box", "give another `filter`"],
    );
    refused(
        with("filter = 'tent'\nfilter_radius = 0.5"),
        ":1:",
        &["filter_radius is 0.5", "1 to 4"],
    );
    refused(
        with("filter = 'tent'\nfilter_radius = nan"),
        ":1:",
        &["filter_radius is NaN"],
    );
    refused(with("wavelengths = 0"), ":1:", &["wavelengths is 0", "1 to 400"]);
    refused(with("pattern = 'sobel'"), ":2:", &["did you mean `sobol`?"]);
    refused(with("filter = 3"), ":2:", &["output.filter"]);
}

#[test]
fn missing_or_unsuitable_textures_are_rejected() {
    refused(
        format!("[texture.t]\nimage = 'no.png'\n{BALL}"),
        ":2:",
        &["no.png", "cannot be read", "check the path"],
    );
    refused(
        format!("[texture.t]\nimage = 'bad.toml'\n{BALL}"),
        ":2:",
        &["cannot be decoded", "PNG, JPEG, HDR or EXR"],
    );
    refused(
        format!("[texture.t]\npattern = 'noise'\noctaves = 99\n{BALL}"),
        ":1:",
        &["out of range"],
    );
    refused(
        format!("[texture.t]\nfilter = 'linear'\n{BALL}"),
        ":1:",
        &["shows nothing"],
    );
    let mesh = "[shape.s.mesh]\nvertices = [[0,0,0],[1,0,0],[0,1,0]]\nfaces = [[0,1,2]]\n[texture.t]\npattern = 'checker'\nspace = 'uv'\n\
                [material.m]\nbase_color = { texture = 't' }\n[[object]]\nshape = 's'\nmaterial = 'm'\n";
    refused(mesh, ":9:", &["texture coordinate set 0", "give the mesh `uv`"]);
}

#[test]
fn invalid_emissive_objects_are_rejected() {
    let with = |object: &str, lines: &str| {
        format!(
            "[material.neon]\nemission = 1\n{lines}\n[[object]]\nname = 'tube'\n{object}\nmaterial = 'neon'\n"
        )
    };
    refused(
        format!("{BALL}lamp = 2\n"),
        ":3:",
        &[
            "object 1.lamp",
            "none of its surfaces emits light",
            "an `emission`",
        ],
    );
    let ball = "shape = 'sphere'\nlamp = true";
    for (object, lines, words) in [
        (ball, "model = 'unlit'", "none of its surfaces emits light"),
        ("shape = 'plane'\nlamp = true", "", "give another shape or a mesh"),
        (
            "shape = 'sphere'\nlamp = true\ntransform_end = [{ translate = [1, 0, 0] }]",
            "",
            "it moves, and lights cannot move",
        ),
        (ball, "transmission = 1", "transmits light"),
        (ball, "alpha = 'blend'", "make it opaque"),
    ] {
        refused(with(object, lines), ":7:", &["object 1.lamp", words]);
    }
    for number in ["0", "-1", "5000", "1.5", "'yes'"] {
        let object = format!("shape = 'sphere'\nlamp = {number}");
        refused(
            with(&object, ""),
            ":7:",
            &["object 1.lamp", "a number of samples from 1 to 4096"],
        );
    }
}

#[test]
fn invalid_volumes_and_fog_are_rejected() {
    let with = |lines: &str| format!("{BALL}[[volume]]\nname = 'v'\n{lines}\n");
    let cloud = "cloud = { shape = 'puff', size = [4, 4, 4] }";
    let transfer = "transfer = [{ value = 0, extinction = 1 }]";
    refused(with(transfer), ":3:", &["volume 1", "exactly one of `file`"]);
    refused(with(cloud), ":3:", &["lacks `transfer`"]);
    refused(
        with(&format!("{cloud}\nfile = 'a.npy'\n{transfer}")),
        ":3:",
        &["exactly one of `file`, `raw` and `cloud`"],
    );
    refused(
        with(&format!("file = 'a.vdb'\n{transfer}")),
        ":5:",
        &["volume 1.file", "OpenVDB", "convert it"],
    );
    refused(
        with(&format!("file = 'none.npy'\n{transfer}")),
        ":5:",
        &["none.npy", "check the path"],
    );
    refused(
        with(&format!(
            "raw = {{ file = 'none.raw', size = [0, 4, 4], type = 'u8' }}\n{transfer}"
        )),
        ":5:",
        &["volume 1.raw"],
    );
    refused(
        with(&format!("{cloud}\ntransfer = [{{ value = 0, opacity = 1 }}]")),
        ":6:",
        &["node 1", "add `opacity_over`"],
    );
    refused(
        with(&format!("{cloud}\ntransfer = []")),
        ":6:",
        &["transfer", "is missing"],
    );
    refused(
        with(&format!("{cloud}\n{transfer}\ntransform = [{{ scale = 0 }}]")),
        ":7:",
        &["volume 1.transform 1", "singular"],
    );
    refused(
        with(&format!("{cloud}\n{transfer}\nstep = 0")),
        ":3:",
        &["volume 1", "positive step"],
    );
    refused(
        with(&format!(
            "cloud = {{ shape = 'puff', size = [9999999, 9999999, 9] }}\n{transfer}"
        )),
        ":5:",
        &["give fewer samples"],
    );
    refused(
        format!("{BALL}[fog]\nextinction = -1\n"),
        ":3:",
        &["fog", "negative"],
    );
}
