//! A picture in the viewer tev, live, over its network protocol.
//!
//! The render is never held up: its threads put rectangles into a queue, and a thread of its own sends them. A viewer
//! that is slow misses rectangles; one that goes away is told of once, and the render goes on.

use std::fmt;
use std::io::{self, Write};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use super::packet;
use super::queue::{Message, Queue};

/// A rectangle of a picture's pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rectangle {
    /// Its first column.
    pub x: u32,
    /// Its first row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Rectangle {
    /// Whether all of `other` lies in it.
    pub(super) fn holds(&self, other: &Rectangle) -> bool {
        let within = |start: u32, size: u32, inner: u32, inner_size: u32| {
            let end = |start: u32, size: u32| u64::from(start) + u64::from(size);
            start <= inner && end(inner, inner_size) <= end(start, size)
        };
        within(self.x, self.width, other.x, other.width) && within(self.y, self.height, other.y, other.height)
    }
}

/// Why there is no connection to a viewer.
#[derive(Debug, thiserror::Error)]
pub enum TevError {
    /// The address makes no sense or is not known.
    #[error("`{address}` is no address of a tev viewer: give HOST:PORT, as in localhost:14158")]
    Address {
        /// What was given.
        address: String,
    },
    /// Nobody answers there.
    #[error(
        "no tev viewer answers at {address}: {source}: start tev there, or give the address of its `--host`"
    )]
    Unreachable {
        /// What was given.
        address: String,
        /// What the system said.
        source: io::Error,
    },
}

/// A connection to a viewer.
pub struct TevViewer {
    address: String,
    stream: TcpStream,
    queue: Arc<Queue>,
    /// Why the connection was lost, until somebody asks.
    trouble: Arc<Mutex<Option<io::Error>>>,
    sender: Option<JoinHandle<()>>,
}

impl fmt::Debug for TevViewer {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.debug_struct("TevViewer")
            .field("address", &self.address)
            .finish_non_exhaustive()
    }
}

impl TevViewer {
    /// Connects to the viewer at `address`, `HOST:PORT`, which has so long to answer.
    pub fn connect(address: &str, timeout: Duration) -> Result<TevViewer, TevError> {
        let unreachable = |source| TevError::Unreachable {
            address: address.to_owned(),
            source,
        };
        let stream = open(address, timeout)?;
        let sending = stream.try_clone().map_err(unreachable)?;
        let (queue, trouble) = (Arc::<Queue>::default(), Arc::default());
        let sender = {
            let (queue, trouble) = (Arc::clone(&queue), Arc::clone(&trouble));
            std::thread::Builder::new()
                .name("tev".into())
                .spawn(move || send_all(sending, &queue, &trouble))
                .map_err(unreachable)?
        };
        Ok(TevViewer {
            address: address.to_owned(),
            stream,
            queue,
            trouble,
            sender: Some(sender),
        })
    }

    /// Makes a black picture of that name, or makes it anew, and shows it; the viewer takes channels R, G and B for
    /// colours.
    pub fn create(&self, name: &str, width: u32, height: u32, channels: &[&str]) {
        self.queue.push(Message {
            changes: None,
            packets: vec![packet::create(name, [width, height], channels)],
        });
    }

    /// Changes a rectangle of the picture of that name. Returns at once.
    ///
    /// `planes` has the rectangle of each of `channels`, row by row, the top row first.
    ///
    /// # Panics
    /// If there is not one plane a channel, or a plane is not of the rectangle's size.
    pub fn update(&self, name: &str, rectangle: Rectangle, channels: &[&str], planes: &[&[f32]]) {
        assert_eq!(channels.len(), planes.len(), "planes for other channels");
        let pixel_count = rectangle.width as usize * rectangle.height as usize;
        assert!(
            planes.iter().all(|plane| plane.len() == pixel_count),
            "planes of another size"
        );
        if channels.is_empty() || pixel_count == 0 {
            return;
        }
        self.queue.push(Message {
            changes: Some((name.to_owned(), rectangle)),
            packets: packet::update(name, rectangle, channels, planes).collect(),
        });
    }

    /// Takes the picture of that name off the viewer.
    pub fn close(&self, name: &str) {
        self.queue.push(Message {
            changes: None,
            packets: vec![packet::close(name)],
        });
    }

    /// One sentence if the connection has been lost, the first time that it is asked for.
    pub fn trouble(&self) -> Option<String> {
        let error = self
            .trouble
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()?;
        Some(format!(
            "the tev viewer at {} is gone: {error}; the render goes on without it",
            self.address
        ))
    }

    /// Ends the connection once all is sent, or `patience` after the viewer has last taken anything. One sentence if not
    /// all is sent and nobody has been told of that.
    pub fn finish(self, patience: Duration) -> Option<String> {
        let is_sent = self.queue.drain(patience);
        let slow = || {
            format!(
                "the tev viewer at {} has not taken all of the picture: what it shows is not complete",
                self.address
            )
        };
        let is_slow = !is_sent && !self.queue.has_ended();
        // Dropped then, which ends the connection.
        self.trouble().or_else(|| is_slow.then(slow))
    }
}

impl Drop for TevViewer {
    fn drop(&mut self) {
        self.queue.end();
        // Whatever is being written comes to its end at once; there is nobody to tell of what is not.
        let _ = self.stream.shutdown(Shutdown::Both);
        if let Some(sender) = self.sender.take() {
            let _ = sender.join();
        }
    }
}

/// The first of the address's places where somebody answers.
fn open(address: &str, timeout: Duration) -> Result<TcpStream, TevError> {
    let no_address = || TevError::Address {
        address: address.to_owned(),
    };
    let places = address.to_socket_addrs().map_err(|_| no_address())?;
    let mut refusal = None;
    for place in places {
        match TcpStream::connect_timeout(&place, timeout) {
            Ok(stream) => {
                // Small rectangles are to be seen at once; without it they are seen a little later.
                let _ = stream.set_nodelay(true);
                return Ok(stream);
            }
            Err(error) => refusal = Some(error),
        }
    }
    Err(refusal.map_or_else(no_address, |source| TevError::Unreachable {
        address: address.to_owned(),
        source,
    }))
}

/// Sends what comes through the queue, until its end or until nobody listens any more.
fn send_all(mut stream: TcpStream, queue: &Queue, trouble: &Mutex<Option<io::Error>>) {
    while let Some(message) = queue.next() {
        for packet in &message.packets {
            if let Err(error) = stream.write_all(packet) {
                *trouble.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                queue.end();
                return;
            }
            queue.note_sent();
        }
    }
}
