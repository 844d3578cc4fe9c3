//! Client of the image viewer tev: shows an image while it is rendered, over tev's network protocol.
//!
//! The render never blocks: its threads put rectangles into a queue, and a separate thread sends them. A slow viewer
//! misses rectangles; a lost connection is reported once, and the render goes on.

use std::fmt;
use std::io::{self, Write};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use super::protocol;
use super::rectangle::Rectangle;
use super::send_queue::{Message, SendQueue};

/// Reasons why there is no connection to a viewer.
#[derive(Debug, thiserror::Error)]
pub enum TevError {
    /// The address is malformed, or its host name is unknown.
    #[error("`{address}` is not an address of a tev viewer: give HOST:PORT, as in localhost:14158")]
    Address {
        /// Address as given by the caller.
        address: String,
    },
    /// No viewer accepts connections at the address.
    #[error(
        "cannot connect to a tev viewer at {address} ({source}): start tev there, or give the address of its `--host`"
    )]
    Unreachable {
        /// Address as given by the caller.
        address: String,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// Connection to a tev viewer, with the thread that sends.
pub struct TevViewer {
    address: String,
    stream: TcpStream,
    queue: Arc<SendQueue>,
    /// Reason why the connection was lost, until [`TevViewer::trouble`] takes it.
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
    /// Connects to the viewer at `address`, `HOST:PORT`; `timeout` applies to each address of the host.
    pub fn connect(address: &str, timeout: Duration) -> Result<TevViewer, TevError> {
        let unreachable = |source| TevError::Unreachable {
            address: address.to_owned(),
            source,
        };
        // Connect, and duplicate the socket for the sending thread
        let stream = open(address, timeout)?;
        let sending = stream.try_clone().map_err(unreachable)?;
        let (queue, trouble) = (Arc::<SendQueue>::default(), Arc::default());
        // Start the thread that sends
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

    /// Creates or re-creates a black image of the given name and shows it; the viewer interprets channels R, G and B as
    /// colours.
    pub fn create(&self, name: &str, width: u32, height: u32, channels: &[&str]) {
        self.queue.push(Message {
            changes: None,
            packets: vec![protocol::create(name, [width, height], channels)],
        });
    }

    /// Updates a rectangle of the image of the given name. Returns at once.
    ///
    /// `planes` has the rectangle of each of `channels`, row by row, the top row first.
    ///
    /// # Panics
    /// If there is not one plane a channel, or a plane is not of the rectangle's size.
    pub fn update(&self, name: &str, rectangle: Rectangle, channels: &[&str], planes: &[&[f32]]) {
        assert_eq!(
            channels.len(),
            planes.len(),
            "number of planes differs from that of the channels"
        );
        let pixel_count = rectangle.width as usize * rectangle.height as usize;
        assert!(
            planes.iter().all(|plane| plane.len() == pixel_count),
            "size of planes differs from that of the rectangle"
        );
        if channels.is_empty() || pixel_count == 0 {
            return;
        }
        self.queue.push(Message {
            changes: Some((name.to_owned(), rectangle)),
            packets: protocol::update(name, rectangle, channels, planes).collect(),
        });
    }

    /// Removes the image of the given name from the viewer.
    pub fn close(&self, name: &str) {
        self.queue.push(Message {
            changes: None,
            packets: vec![protocol::close(name)],
        });
    }

    /// Returns one sentence if the connection has been lost, and `None` at every later call.
    pub fn trouble(&self) -> Option<String> {
        let error = self
            .trouble
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()?;
        Some(format!(
            "lost the connection to the tev viewer at {} ({error}); the render continues without it",
            self.address
        ))
    }

    /// Closes the connection once all messages are sent, or `patience` after the last packet. Returns one sentence if
    /// not all is sent and the loss has not been reported yet.
    pub fn finish(self, patience: Duration) -> Option<String> {
        let is_sent = self.queue.drain(patience);
        let slow = || {
            format!(
                "the tev viewer at {} has not received the whole image: the displayed image is incomplete",
                self.address
            )
        };
        let is_slow = !is_sent && !self.queue.has_ended();
        // `self` is dropped at the end, which closes the connection.
        self.trouble().or_else(|| is_slow.then(slow))
    }
}

impl Drop for TevViewer {
    fn drop(&mut self) {
        self.queue.end();
        // The shutdown aborts a pending write at once; its error is of no use any more.
        let _ = self.stream.shutdown(Shutdown::Both);
        if let Some(sender) = self.sender.take() {
            let _ = sender.join();
        }
    }
}

/// Connects to the first of the address's socket addresses that accepts the connection.
fn open(address: &str, timeout: Duration) -> Result<TcpStream, TevError> {
    let no_address = || TevError::Address {
        address: address.to_owned(),
    };
    // Try the addresses of the host in order
    let addresses = address.to_socket_addrs().map_err(|_| no_address())?;
    let mut last_error = None;
    for socket_address in addresses {
        match TcpStream::connect_timeout(&socket_address, timeout) {
            Ok(stream) => {
                // Without Nagle's algorithm small rectangles appear at once; failing to disable it only delays them a
                // little.
                let _ = stream.set_nodelay(true);
                return Ok(stream);
            }
            Err(error) => last_error = Some(error),
        }
    }
    Err(
        last_error.map_or_else(no_address, |source| TevError::Unreachable {
            address: address.to_owned(),
            source,
        }),
    )
}

/// Sends the messages of the queue until it is closed or the connection is lost.
fn send_all(mut stream: TcpStream, queue: &SendQueue, trouble: &Mutex<Option<io::Error>>) {
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
