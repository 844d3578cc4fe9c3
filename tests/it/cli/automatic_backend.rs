//! Choice of `--backend auto`, as a process prints it.

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
