//! Live preview in tev, tested against a receiver that is written from the description of the protocol (tev's README,
//! "Over the Network", and its `Ipc.cpp`), independently of the sender.

use std::io::{ErrorKind, Read};
use std::net::{TcpListener, TcpStream};
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crate::support::cli_program::{first_light, whit};
use whit::accel::{self, AccelOptions, Backend};
use whit::gltf::LoadOptions;
use whit::render::{Adaptive, FinishedTile, Monitor, RenderSettings, render};
use whit::watch::{Rectangle, TevViewer};

const PATIENCE: Duration = Duration::from_secs(20);

/// Operation of a packet.
#[derive(Clone, Debug, PartialEq)]
enum Packet {
    Close(String),
    Create {
        name: String,
        grabs_focus: bool,
        size: [i32; 2],
        channels: Vec<String>,
    },
    Update {
        name: String,
        grabs_focus: bool,
        channels: Vec<String>,
        /// Column, row, width, height.
        rectangle: [i32; 4],
        planes: Vec<Vec<f32>>,
    },
}

/// Reader of the rest of a packet.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let (taken, rest) = self.0.split_at(N);
        self.0 = rest;
        taken.try_into().unwrap()
    }

    fn flag(&mut self) -> bool {
        let [byte] = self.take();
        assert!(byte <= 1, "a flag of {byte}");
        byte == 1
    }

    fn int(&mut self) -> i32 {
        i32::from_le_bytes(self.take())
    }

    fn long(&mut self) -> usize {
        i64::from_le_bytes(self.take()).try_into().unwrap()
    }

    fn text(&mut self) -> String {
        let end = self
            .0
            .iter()
            .position(|&byte| byte == 0)
            .expect("text ends with a zero");
        let text = String::from_utf8(self.0[..end].to_vec()).unwrap();
        self.0 = &self.0[end + 1..];
        text
    }

    fn texts(&mut self, count: i32) -> Vec<String> {
        (0..count).map(|_| self.text()).collect()
    }
}

/// Parses a whole packet: the length, which includes itself, the operation, and its arguments.
fn packet(bytes: &[u8]) -> Packet {
    let mut reader = Reader(bytes);
    assert_eq!(reader.int() as usize, bytes.len());
    let [operation] = reader.take();
    let packet = match operation {
        2 => Packet::Close(reader.text()),
        4 => {
            let grabs_focus = reader.flag();
            let name = reader.text();
            let size = [reader.int(), reader.int()];
            let count = reader.int();
            Packet::Create {
                name,
                grabs_focus,
                size,
                channels: reader.texts(count),
            }
        }
        6 => update(&mut reader),
        other => panic!("operation {other}"),
    };
    assert!(reader.0.is_empty(), "{} bytes too many", reader.0.len());
    packet
}

fn update(reader: &mut Reader) -> Packet {
    let grabs_focus = reader.flag();
    let name = reader.text();
    let count = reader.int();
    let channels = reader.texts(count);
    let rectangle = [0; 4].map(|_| reader.int());
    let offsets: Vec<usize> = channels.iter().map(|_| reader.long()).collect();
    let strides: Vec<usize> = channels.iter().map(|_| reader.long()).collect();
    let pixels = rectangle[2] as usize * rectangle[3] as usize;
    let ends = offsets.iter().zip(&strides);
    let float_count = ends
        .map(|(offset, stride)| offset + (pixels - 1) * stride + 1)
        .max()
        .unwrap();
    let floats: Vec<f32> = (0..float_count)
        .map(|_| f32::from_le_bytes(reader.take()))
        .collect();
    let plane = |(&offset, &stride): (&usize, &usize)| {
        let values = (0..pixels).map(|pixel| floats[offset + pixel * stride]);
        values.collect()
    };
    Packet::Update {
        name,
        grabs_focus,
        channels,
        rectangle,
        planes: offsets.iter().zip(&strides).map(plane).collect(),
    }
}

/// Returns the bytes of the next packet; `None` at the end.
fn next(stream: &mut TcpStream) -> Option<Vec<u8>> {
    let mut bytes = vec![0; 4];
    match stream.read_exact(&mut bytes) {
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => return None,
        other => other.unwrap(),
    }
    bytes.resize(u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize, 0);
    stream.read_exact(&mut bytes[4..]).unwrap();
    Some(bytes)
}

/// Starts a receiver of one connection and returns its address.
fn receiver<T: Send + 'static>(
    receive: impl FnOnce(TcpStream) -> T + Send + 'static,
) -> (String, JoinHandle<T>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    (
        address,
        thread::spawn(move || receive(listener.accept().unwrap().0)),
    )
}

/// Starts a receiver that reads all packets.
fn all_bytes() -> (String, JoinHandle<Vec<Vec<u8>>>) {
    receiver(|mut stream| std::iter::from_fn(|| next(&mut stream)).collect())
}

fn connect(address: &str) -> TevViewer {
    TevViewer::connect(address, PATIENCE).unwrap()
}

fn rectangle(x: u32, y: u32, width: u32, height: u32) -> Rectangle {
    Rectangle { x, y, width, height }
}

/// Image as the viewer shows it.
struct Shown {
    size: [i32; 2],
    channels: Vec<String>,
    planes: Vec<Vec<f32>>,
}

impl Shown {
    fn change(&mut self, given: &[String], [x, y, width, height]: [i32; 4], planes: &[Vec<f32>]) {
        assert!(x >= 0 && y >= 0 && x + width <= self.size[0] && y + height <= self.size[1]);
        for (channel, plane) in given.iter().zip(planes) {
            let place = self.channels.iter().position(|known| known == channel).unwrap();
            for (row, values) in plane.chunks(width as usize).enumerate() {
                let first = (y as usize + row) * self.size[0] as usize + x as usize;
                self.planes[place][first..first + values.len()].copy_from_slice(values);
            }
        }
    }
}

/// Returns the size and the planes of an image after all packets.
fn final_image(packets: &[Packet], wanted: &str) -> ([i32; 2], Vec<Vec<f32>>) {
    let mut seen: Option<Shown> = None;
    for packet in packets {
        match packet {
            Packet::Create {
                name, size, channels, ..
            } if name == wanted => {
                let black = vec![0.0; (size[0] * size[1]) as usize];
                seen = Some(Shown {
                    size: *size,
                    channels: channels.clone(),
                    planes: vec![black; channels.len()],
                });
            }
            Packet::Update {
                name,
                channels,
                rectangle,
                planes,
                ..
            } if name == wanted => {
                let shown = seen.as_mut().expect("made before it is changed");
                shown.change(channels, *rectangle, planes);
            }
            _ => {}
        }
    }
    let shown = seen.expect("made");
    (shown.size, shown.planes)
}

#[test]
fn packets_match_the_protocol_to_the_byte() {
    let (address, received) = all_bytes();
    let viewer = connect(&address);
    viewer.create("a", 3, 2, &["R", "Zé"]);
    viewer.update(
        "a",
        rectangle(1, 0, 2, 1),
        &["R", "Zé"],
        &[&[1.0, 2.0], &[-0.5, f32::NAN]],
    );
    viewer.close("a");
    assert_eq!(viewer.finish(PATIENCE), None);
    let [create, update, close] = &received.join().unwrap()[..] else {
        panic!("three packets");
    };
    let mut made = vec![26, 0, 0, 0, 4, 1, b'a', 0, 3, 0, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0];
    made.extend(b"R\0Z\xc3\xa9\0");
    assert_eq!(*create, made);
    let mut changed = vec![82, 0, 0, 0, 6, 0, b'a', 0, 2, 0, 0, 0];
    changed.extend(b"R\0Z\xc3\xa9\0");
    for number in [1i32, 0, 2, 1] {
        changed.extend(number.to_le_bytes());
    }
    for number in [0i64, 1, 2, 2] {
        changed.extend(number.to_le_bytes());
    }
    for value in [1.0f32, -0.5, 2.0, f32::NAN] {
        changed.extend(value.to_le_bytes());
    }
    assert_eq!(*update, changed);
    assert_eq!(*close, [7, 0, 0, 0, 2, b'a', 0]);
}

#[test]
fn images_of_any_size_and_name_arrive_complete() {
    for (width, height, name) in [
        (1, 1, "a"),
        (7, 5, "Grün 緑/ü b.exr"),
        (301, 1, ""),
        (1, 977, "a:b"),
        (1023, 769, "large"),
        (70_001, 3, "wide"),
    ] {
        let (address, received) = all_bytes();
        let viewer = connect(&address);
        viewer.create(name, width, height, &["R", "G", "B"]);
        let plane =
            |channel: u32| -> Vec<f32> { (0..width * height).map(|i| (3 * i + channel) as f32).collect() };
        let planes = [0, 1, 2].map(plane);
        let all = [&planes[0][..], &planes[1], &planes[2]];
        viewer.update(name, rectangle(0, 0, width, height), &["R", "G", "B"], &all);
        assert_eq!(viewer.finish(PATIENCE), None);
        let bytes = received.join().unwrap();
        assert!(bytes.iter().all(|packet| packet.len() < 1 << 20), "{name}");
        let packets: Vec<Packet> = bytes.iter().map(|bytes| packet(bytes)).collect();
        let (size, shown) = final_image(&packets, name);
        assert_eq!(size, [width as i32, height as i32]);
        assert!(shown == planes, "{name} differs");
    }
}

#[test]
fn viewer_that_receives_nothing_does_not_block() {
    let (end, ended) = std::sync::mpsc::channel();
    let (address, received) = receiver(move |stream| {
        // Keep the connection open until the render is over.
        let _ = ended.recv();
        drop(stream);
    });
    let viewer = connect(&address);
    viewer.create("a", 4096, 4096, &["R", "G", "B"]);
    let plane = vec![0.5; 1024];
    let start = Instant::now();
    // 16384 tiles, 200 MB.
    for i in 0..1 << 14 {
        let at = rectangle(i % 128 * 32, i / 128 * 32, 32, 32);
        viewer.update("a", at, &["R", "G", "B"], &[&plane, &plane, &plane]);
    }
    let sending = start.elapsed();
    let warning = viewer.finish(Duration::from_millis(50)).expect("a warning");
    assert!(warning.contains("is incomplete"), "{warning}");
    let all = start.elapsed();
    end.send(()).unwrap();
    received.join().unwrap();
    // Waiting for the receiver would take forever: minutes are for slow machines.
    assert!(all < Duration::from_secs(300), "{sending:?}, {all:?}");
}

#[test]
fn lost_connection_is_reported_once() {
    let (address, received) = receiver(|mut stream| {
        packet(&next(&mut stream).unwrap());
        // Read only half of the next packet.
        stream.read_exact(&mut [0; 10]).unwrap();
    });
    let viewer = connect(&address);
    viewer.create("a", 32, 32, &["Y"]);
    let plane = vec![0.5; 1024];
    let start = Instant::now();
    let trouble = loop {
        viewer.update("a", rectangle(0, 0, 32, 32), &["Y"], &[&plane]);
        if let Some(trouble) = viewer.trouble() {
            break trouble;
        }
        assert!(start.elapsed() < PATIENCE, "the loss is not reported");
        thread::sleep(Duration::from_millis(1));
    };
    received.join().unwrap();
    assert!(
        trouble.contains(&address) && trouble.contains("continues without it"),
        "{trouble}"
    );
    viewer.update("a", rectangle(0, 0, 32, 32), &["Y"], &[&plane]);
    assert_eq!(viewer.trouble(), None);
    assert_eq!(viewer.finish(PATIENCE), None);
}

#[test]
fn missing_viewer_is_an_error_with_its_remedy() {
    // Use a port that was free a moment ago.
    let address = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .to_string();
    for (address, words) in [
        (&*address, "start tev there"),
        ("nonsense", "give HOST:PORT"),
        ("a:b:c", "give HOST:PORT"),
    ] {
        let error = TevViewer::connect(address, PATIENCE).unwrap_err().to_string();
        assert!(error.contains(address) && error.contains(words), "{error}");
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("a.png");
        let run = whit(&[
            "render",
            &first_light(),
            "-o",
            out.to_str().unwrap(),
            "--tev",
            address,
        ]);
        assert_eq!((run.code, run.stderr.lines().count()), (2, 1), "{}", run.stderr);
        assert!(!out.exists());
    }
}

/// Renders with a viewer that runs `receive`; returns its result, standard error, and the name and planes of the image.
fn rendered<T: Send + 'static>(
    receive: impl FnOnce(TcpStream) -> T + Send + 'static,
    flags: &[&str],
) -> (T, String, String, Vec<Vec<f32>>) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.exr");
    let out = out.to_str().unwrap();
    let (address, received) = receiver(receive);
    let args = [
        "render",
        &first_light(),
        "-o",
        out,
        "--size",
        "100x70",
        "--tev",
        &address,
    ];
    let run = whit(&[&args, flags].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    let image = whit::image::read_exr(out.as_ref()).unwrap();
    let plane = |channel: usize| image.pixels.iter().map(|pixel| pixel[channel]).collect();
    (
        received.join().unwrap(),
        run.stderr,
        out.to_owned(),
        [0, 1, 2].map(plane).into(),
    )
}

#[test]
fn viewer_shows_tiles_and_finally_the_written_image() {
    for flags in [
        &["--spp", "4"][..],
        &["--spp", "4", "--filter", "mitchell"],
        &["--spp", "32", "--adaptive", "0.01"],
    ] {
        let receive = |mut stream: TcpStream| -> Vec<Packet> {
            std::iter::from_fn(|| next(&mut stream))
                .map(|bytes| packet(&bytes))
                .collect()
        };
        let (packets, words, name, written) = rendered(receive, flags);
        assert_eq!(words, "", "{flags:?}");
        let (size, shown) = final_image(&packets, &name);
        assert_eq!(size, [100, 70]);
        assert!(shown == written, "{flags:?}");
        assert!(
            matches!(&packets[0], Packet::Create { grabs_focus: true, channels, .. } if channels == &["R", "G", "B"])
        );
    }
}

#[test]
fn finished_tiles_equal_the_image_without_a_filter() {
    let scene = whit::gltf::load(first_light().as_ref(), &LoadOptions::default()).unwrap();
    let accel = accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap();
    let adaptive = Some(Adaptive {
        error: 0.01,
        gain: 1.0,
    });
    for (spp, adaptive) in [(4, None), (32, adaptive)] {
        let settings = RenderSettings {
            width: 100,
            height: 70,
            spp,
            adaptive,
            ..RenderSettings::default()
        };
        let seen = Mutex::new((vec![[f32::NAN; 3]; 7000], 0));
        let see = |tile: FinishedTile| {
            let (pixels, count) = &mut *seen.lock().unwrap();
            *count += 1;
            for (row, means) in tile.pixels.chunks(tile.width as usize).enumerate() {
                let first = (tile.y as usize + row) * 100 + tile.x as usize;
                pixels[first..first + means.len()].copy_from_slice(means);
            }
        };
        let monitor = Monitor {
            progress: &|_| {},
            cancel: &AtomicBool::new(false),
            tiles: Some(&see),
        };
        let rendering = render(
            scene.validate().unwrap(),
            &scene.cameras[0],
            &*accel,
            &settings,
            &monitor,
        )
        .unwrap();
        let (pixels, count) = seen.into_inner().unwrap();
        assert!(pixels == rendering.image.pixels, "{spp} samples");
        // There are 4 x 3 tiles; adaptive sampling renders some of them again.
        assert!(
            if adaptive.is_none() {
                count == 12
            } else {
                count > 12
            },
            "{count} tiles"
        );
    }
}

#[test]
fn render_continues_after_losing_the_viewer() {
    let (_, words, _, written) = rendered(drop, &["--spp", "8"]);
    let (_, _, _, alone) = rendered(|mut stream| while next(&mut stream).is_some() {}, &["--spp", "8"]);
    assert!(written == alone);
    // The loss of the connection may go undetected until after the last packet.
    assert!(
        words.is_empty() || (words.lines().count() == 1 && words.contains("continues without it")),
        "{words}"
    );
}

#[test]
fn batch_frames_are_shown_and_older_ones_are_closed() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (jobs, out) = (path("film.jobs.toml"), path("film"));
    let text = format!(
        "settings = {{ size = \"50x40\", filter = \"tent\" }}\nscene = {:?}\n[[job]]\nframes = 11\nturntable = {{}}\n\
         image = \"{{frame}}.exr\"\n",
        first_light()
    );
    std::fs::write(&jobs, text).unwrap();
    let (address, received) = all_bytes();
    let run = whit(&["batch", &jobs, "--out", &out, "--tev", &address]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let packets: Vec<Packet> = received
        .join()
        .unwrap()
        .iter()
        .map(|bytes| packet(bytes))
        .collect();
    for frame in 1..=11 {
        let name = format!("{frame}.exr");
        let (size, shown) = final_image(&packets, &name);
        assert_eq!(size, [50, 40]);
        let written = whit::image::read_exr(path(&format!("film/{name}")).as_ref()).unwrap();
        for (channel, plane) in shown.iter().enumerate() {
            assert!(
                written
                    .pixels
                    .iter()
                    .map(|pixel| pixel[channel])
                    .eq(plane.iter().copied()),
                "{name}"
            );
        }
    }
    // The first three frames are closed, which start two at a time; eight remain.
    let closed = packets.iter().filter_map(|packet| match packet {
        Packet::Close(name) => name.strip_suffix(".exr")?.parse::<u32>().ok(),
        _ => None,
    });
    let closed: Vec<u32> = closed.collect();
    assert_eq!(closed.len(), 3);
    assert!(closed.iter().all(|&frame| frame <= 4), "{closed:?}");
}
