//! Choice of `--backend auto`, as a process prints it.

use serde_json::Value;

use crate::support::cli_program::{first_light, whit};

#[test]
fn the_automatic_backend_prints_its_choice() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.png");
    let size = ["--size", "40x30", "--spp", "1"];
    let run = whit(
        &[
            &[
                "render",
                &first_light(),
                "-o",
                out.to_str().unwrap(),
                "--backend",
                "auto",
            ],
            &size[..],
        ]
        .concat(),
    );
    assert_eq!(run.code, 0, "{}", run.stderr);
    // The scene is made of shapes
    let backend = if cfg!(feature = "embree") {
        "embree"
    } else {
        "native"
    };
    let expected = format!("backend: {backend} for all rays: ");
    assert!(run.stdout.contains(&expected), "{}", run.stdout);
}

#[test]
fn a_scene_file_names_the_backend_and_the_flag_overrides_it() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let scene = "[output]\nsize = [8, 6]\nspp = 1\nbackend = \"brute\"\n[camera]\nfrom = [0, 0, 5]\nat = [0, 0, 0]\n\
                 [[object]]\nshape = \"sphere\"\n";
    std::fs::write(at("a.toml"), scene).unwrap();
    std::fs::write(
        at("jobs.toml"),
        "[[job]]\nscene = \"a.toml\"\nimage = \"b.png\"\n",
    )
    .unwrap();
    // Render alone, with and without the flag
    for (flags, backend) in [(&[][..], "brute"), (&["--backend", "bsp"], "bsp")] {
        let fixed = [
            "render",
            &at("a.toml"),
            "-o",
            &at("a.png"),
            "--stats",
            &at("a.json"),
        ];
        let run = whit(&[&fixed[..], flags].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
        let stats: Value = serde_json::from_slice(&std::fs::read(at("a.json")).unwrap()).unwrap();
        assert_eq!(stats["backend"], backend);
    }
    // Render in a batch, whose images record their settings
    let run = whit(&[
        "batch",
        &at("jobs.toml"),
        "--out",
        folder.path().to_str().unwrap(),
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let image = std::fs::read(at("b.png")).unwrap();
    let recorded = String::from_utf8_lossy(&image);
    assert!(recorded.contains("\"backend\":\"brute\""));
}
