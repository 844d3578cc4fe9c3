//! Frames that are divided into shards and pieces: the images equal those of one process to the byte.

use std::fs;
use std::path::Path;
use std::process::Stdio;

use super::frames::{Place, assert_done, images, name, run, whit};

#[test]
fn shards_in_any_order_equal_one_run_to_the_byte() {
    let place = Place::new();
    let job = |split: &str, image: &str, more: &str| {
        format!(
            "[[job]]\nscene = \"scene.toml\"\nframes = 2\nturntable = {{}}\n{split}\n\
             settings = {{ size = \"20x130\", spp = 12, pattern = \"sobol\", backend = \"bsp\"{more} }}\nimage = \"{image}\"\n"
        )
    };
    let text = [
        job(
            "split = { bands = 3, shares = 2 }",
            "a.{frame}.exr",
            ", aov = \"samples\"",
        ),
        job(
            "split = { bands = 5 }",
            "b.{frame}.png",
            ", filter = \"mitchell\"",
        ),
        job(
            "split = { shares = 3 }",
            "c.{frame}.exr",
            ", filter = \"gaussian\", exr-type = \"half\", compression = \"zip\"",
        ),
        job("", "d.{frame}.png", ""),
    ];
    let jobs = place.jobs(&text.concat());
    let [one, many] = ["one", "many"].map(|name| place.out(name));
    assert_done(&run(&["batch", &jobs, "--out", &one, "--quiet"]));
    let expected = images(&one);
    assert_eq!(expected.len(), 8);
    for shard in [5, 2, 7, 1, 3, 6, 4] {
        let shard = format!("{shard}/7");
        assert_done(&run(&[
            "batch", &jobs, "--out", &many, "--shard", &shard, "--quiet",
        ]));
        // Run the shard again, as a scheduler does that has missed the end of a task.
        assert_done(&run(&[
            "batch", &jobs, "--out", &many, "--shard", &shard, "--resume", "--quiet",
        ]));
    }
    assert_eq!(images(&many), expected);
    assert!(!Path::new(&many).join(".whit-pieces").exists());
}

#[test]
fn merge_lists_incomplete_frames_and_merges_the_rest() {
    let place = Place::new();
    let jobs = place.jobs(
        "[[job]]\nscene = \"scene.toml\"\nframes = 2\nturntable = {}\nsplit = { bands = 2 }\n\
         settings = { size = \"40x64\", backend = \"bsp\" }\nimage = \"{frame}.png\"\n",
    );
    let out = place.out("out");
    // Render three pieces of four; the second one completes frame 1.
    for shard in ["1/4", "2/4", "3/4"] {
        assert_done(&run(&[
            "batch", &jobs, "--out", &out, "--shard", shard, "--quiet",
        ]));
    }
    assert_eq!(images(&out).len(), 1);
    let merged = run(&["merge", &out]);
    assert_eq!(merged.status.code(), Some(1));
    let said = String::from_utf8_lossy(&merged.stderr);
    assert!(
        said.contains("2.png: 32 of 64 rows are missing: render them with `whit batch --resume`"),
        "{said}"
    );
    assert_done(&run(&[
        "batch", &jobs, "--out", &out, "--shard", "4/4", "--quiet",
    ]));
    assert_eq!(images(&out).len(), 2);
    assert_done(&run(&["merge", &out]));
}

#[test]
fn duplicate_processes_of_a_shard_do_no_harm() {
    let place = Place::new();
    let jobs = place.jobs(
        "[[job]]\nscene = \"scene.toml\"\nframes = 8\nturntable = {}\nsplit = { bands = 2, shares = 2 }\n\
         settings = { size = \"48x64\", spp = 32, pattern = \"sobol\", backend = \"bsp\" }\nimage = \"{frame:02}.exr\"\n",
    );
    let [reference, out] = ["reference", "out"].map(|name| place.out(name));
    assert_done(&run(&["batch", &jobs, "--out", &reference, "--quiet"]));
    // All four processes work on the same frames, and pairs of them on the same pieces.
    let shards = ["1/2", "2/2", "1/2", "2/2"];
    let batch = |shard| {
        whit(&[
            "batch",
            &jobs,
            "--out",
            &out,
            "--shard",
            shard,
            "--resume",
            "--checkpoint",
            "0",
        ])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
    };
    for child in shards.map(batch) {
        assert_done(&child.wait_with_output().unwrap());
    }
    // Merging removes the pieces of a duplicate task without an error.
    assert_done(&run(&["merge", &out]));
    assert!(images(&out) == images(&reference));
    assert!(!Path::new(&out).join(".whit-pieces").exists());
}

#[test]
fn merged_frames_are_done_and_outdated_pieces_are_removed() {
    let place = Place::new();
    let job = |spp: u32| {
        format!(
            "[[job]]\nscene = \"scene.toml\"\nsplit = {{ bands = 2 }}\nimage = \"a.png\"\n\
             settings = {{ size = \"40x64\", spp = {spp}, backend = \"bsp\" }}\n"
        )
    };
    let jobs = place.jobs(&job(1));
    let [one, two] = ["one", "two"].map(|name| place.out(name));
    let shard = |out: &str, shard: &str| {
        assert_done(&run(&["batch", &jobs, "--out", out, "--shard", shard, "-q"]));
    };
    // Each folder has one piece only, as on machines that do not share a disk.
    shard(&one, "1/2");
    shard(&two, "2/2");
    let pieces = |out: &str| {
        let frame = fs::read_dir(Path::new(out).join(".whit-pieces")).unwrap().next();
        frame.unwrap().unwrap().path()
    };
    for piece in fs::read_dir(pieces(&two)).unwrap() {
        let piece = piece.unwrap().path();
        fs::copy(&piece, pieces(&one).join(name(&piece))).unwrap();
    }
    assert_done(&run(&["merge", &one]));
    let resumed = run(&["batch", &jobs, "--out", &one, "--resume"]);
    assert_done(&resumed);
    let said = String::from_utf8_lossy(&resumed.stdout);
    assert!(said.contains("1 existed already"), "{said}");
    place.jobs(&job(2));
    shard(&two, "1/1");
    assert!(!Path::new(&two).join(".whit-pieces").exists());
}

#[test]
fn frames_that_differ_only_in_name_have_separate_pieces() {
    let place = Place::new();
    let jobs = place.jobs(
        "scene = \"scene.toml\"\nsettings = { size = \"24x70\" }\n[[job]]\nimage = \"whole.exr\"\n\
         [[job]]\nsplit = { bands = 3 }\nimage = \"bands.exr\"\n",
    );
    let out = place.out("out");
    // Finish the whole frame while the other has two of its three bands.
    for shard in ["4/4", "2/4", "1/4", "3/4"] {
        assert_done(&run(&["batch", &jobs, "--out", &out, "--shard", shard, "-q"]));
    }
    let image = |name: &str| fs::read(place.path("out").join(name)).unwrap();
    assert!(image("bands.exr") == image("whole.exr"));
}

#[test]
fn transparent_frames_in_bands_equal_those_of_one_process() {
    let place = Place::new();
    let scene = "background = 2\ncamera = { from = [0, 0, 4], at = [0, 0, 0], fov = 40 }\n\
                 object = [{ shape = \"sphere\" }]\n[output]\nbackground = \"transparent\"\n";
    fs::write(place.path("clear.toml"), scene).unwrap();
    let job = |split: &str, image: &str| {
        format!(
            "[[job]]\nscene = \"clear.toml\"\n{split}\nsettings = {{ size = \"30x130\", spp = 32, backend = \"bsp\" }}\n\
             image = \"{image}\"\n"
        )
    };
    let bands = "split = { bands = 3 }";
    let jobs = place.jobs(&[job(bands, "a.png"), job(bands, "a.exr")].concat());
    let [one, many] = ["one", "many"].map(|name| place.out(name));
    assert_done(&run(&["batch", &jobs, "--out", &one, "--quiet"]));
    for shard in ["2/3", "3/3", "1/3"] {
        assert_done(&run(&[
            "batch", &jobs, "--out", &many, "--shard", shard, "--quiet",
        ]));
    }
    assert_eq!(images(&one).len(), 2);
    assert_eq!(images(&many), images(&one));
    let shown = image::open(Path::new(&one).join("a.png")).unwrap();
    assert_eq!(shown.color(), image::ColorType::Rgba8);
    assert_eq!(shown.into_rgba8().get_pixel(0, 0)[3], 0);
    // Shares of samples have no coverage
    let jobs = place.jobs(&job("split = { shares = 2 }", "b.png"));
    let refused = run(&["batch", &jobs, "--out", &place.out("shares"), "--quiet"]);
    assert_ne!(refused.status.code(), Some(0));
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(said.contains("do not support a transparent background"), "{said}");
}
