//! Bounded send queue between the render threads and a viewer; pushing a message never blocks.
//!
//! A rectangle that is changed again before it was sent is sent once, with the newest pixels. When a viewer accepts
//! less than is rendered, the oldest rectangles are dropped.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::rectangle::Rectangle;

/// Largest number of bytes in the queue: an image of 22 million pixels.
const MAX_BYTES: usize = 1 << 28;
/// Largest number of messages in the queue. Each push scans all of them, which takes microseconds at this size.
const MAX_MESSAGES: usize = 1 << 12;

/// Packets that are sent together and superseded together.
pub(super) struct Message {
    /// Image name and rectangle that the packets change; none for messages that must not be dropped.
    pub(super) changes: Option<(String, Rectangle)>,
    pub(super) packets: Vec<Vec<u8>>,
}

impl Message {
    fn byte_count(&self) -> usize {
        self.packets.iter().map(Vec::len).sum()
    }

    /// Returns whether this message need not be sent because `newer` covers its whole rectangle of the same image.
    fn is_superseded_by(&self, newer: &Message) -> bool {
        match (&self.changes, &newer.changes) {
            (Some((name, old)), Some((newer_name, new))) => new.holds(old) && name == newer_name,
            _ => false,
        }
    }
}

#[derive(Default)]
struct QueueState {
    waiting: VecDeque<Message>,
    byte_count: usize,
    /// True while a message that was taken from the queue is not yet known to be sent.
    sending: bool,
    /// Number of packets sent so far.
    sent_count: u64,
    /// True once the queue is closed: no more messages come, or the sender has stopped.
    ended: bool,
}

/// Queue between the threads of a render and the thread that sends.
#[derive(Default)]
pub(super) struct SendQueue {
    state: Mutex<QueueState>,
    changed: Condvar,
}

impl SendQueue {
    fn lock(&self) -> MutexGuard<'_, QueueState> {
        // Ignoring poisoning is safe: a panic in another thread leaves no state half-changed.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Appends a message; takes no longer than one scan of the queue.
    pub(super) fn push(&self, message: Message) {
        let mut state = self.lock();
        if state.ended {
            return;
        }
        let mut byte_count = state.byte_count + message.byte_count();
        // Remove queued messages that the new one supersedes
        state.waiting.retain(|old| {
            let is_superseded = old.is_superseded_by(&message);
            byte_count -= if is_superseded { old.byte_count() } else { 0 };
            !is_superseded
        });
        state.byte_count = byte_count;
        state.waiting.push_back(message);
        // Drop the oldest updates until both limits hold
        while state.byte_count > MAX_BYTES || state.waiting.len() > MAX_MESSAGES {
            let oldest = state.waiting.iter().position(|old| old.changes.is_some());
            let Some(left_out) = oldest.and_then(|place| state.waiting.remove(place)) else {
                break;
            };
            state.byte_count -= left_out.byte_count();
        }
        drop(state);
        self.changed.notify_all();
    }

    /// Waits for the next message and returns it, or `None` once the queue is closed. The call also confirms that the
    /// previous message is sent.
    pub(super) fn next(&self) -> Option<Message> {
        let mut state = self.lock();
        state.sending = false;
        self.changed.notify_all();
        // Taking the next message shows that the last one is sent
        loop {
            if state.ended {
                return None;
            }
            if let Some(message) = state.waiting.pop_front() {
                state.byte_count -= message.byte_count();
                state.sending = true;
                return Some(message);
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Counts a packet that was sent.
    pub(super) fn note_sent(&self) {
        self.lock().sent_count += 1;
        self.changed.notify_all();
    }

    /// Closes the queue and discards all messages in it.
    pub(super) fn end(&self) {
        let mut state = self.lock();
        state.ended = true;
        state.waiting.clear();
        state.byte_count = 0;
        drop(state);
        self.changed.notify_all();
    }

    /// Returns whether the queue is closed, so that no message is sent any more.
    pub(super) fn has_ended(&self) -> bool {
        self.lock().ended
    }

    /// Waits until all messages are sent, or until `timeout` has passed since the last packet; returns whether all are
    /// sent.
    pub(super) fn drain(&self, timeout: Duration) -> bool {
        let mut state = self.lock();
        let mut deadline = Instant::now() + timeout;
        loop {
            // Report failure if the connection was lost meanwhile
            if state.ended || (state.waiting.is_empty() && !state.sending) {
                return !state.ended;
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            let before = state.sent_count;
            state = self
                .changed
                .wait_timeout(state, left)
                .unwrap_or_else(PoisonError::into_inner)
                .0;
            // Restart the timeout after each packet: a slow viewer is not a dead one
            if state.sent_count != before {
                deadline = Instant::now() + timeout;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn change(name: &str, x: u32, width: u32, byte: u8, count: usize) -> Message {
        let rectangle = Rectangle {
            x,
            y: 0,
            width,
            height: 1,
        };
        Message {
            changes: Some((name.to_owned(), rectangle)),
            packets: vec![vec![byte; count]],
        }
    }

    /// Returns the first byte of every queued message.
    fn waiting(queue: &SendQueue) -> Vec<u8> {
        let state = queue.lock();
        assert_eq!(
            state.byte_count,
            state.waiting.iter().map(Message::byte_count).sum::<usize>()
        );
        state
            .waiting
            .iter()
            .map(|message| message.packets[0][0])
            .collect()
    }

    #[test]
    fn newer_rectangle_replaces_those_it_covers() {
        let queue = SendQueue::default();
        for message in [
            change("a", 0, 4, 1, 9),
            change("a", 4, 4, 2, 9),
            change("b", 0, 4, 3, 9),
            change("a", 0, 4, 4, 9),
        ] {
            queue.push(message);
        }
        assert_eq!(waiting(&queue), [2, 3, 4]);
        queue.push(change("a", 0, 8, 5, 9));
        assert_eq!(waiting(&queue), [3, 5]);
    }

    #[test]
    fn full_queue_drops_only_the_oldest_rectangles() {
        let queue = SendQueue::default();
        queue.push(Message {
            changes: None,
            packets: vec![vec![1; 10]],
        });
        for byte in 2..5 {
            queue.push(change("a", u32::from(byte), 1, byte, MAX_BYTES / 2 - 10));
        }
        assert_eq!(waiting(&queue), [1, 3, 4]);
    }

    #[test]
    fn drain_times_out_if_nothing_is_received() {
        let queue = SendQueue::default();
        assert!(queue.drain(Duration::ZERO));
        queue.push(change("a", 0, 1, 1, 9));
        assert!(!queue.drain(Duration::from_millis(1)));
        assert!(queue.next().is_some());
        // The message was taken, but it is unknown whether it was sent.
        assert!(!queue.drain(Duration::from_millis(1)));
        queue.end();
        assert!(queue.next().is_none());
        queue.push(change("a", 0, 1, 1, 9));
        assert!(waiting(&queue).is_empty());
    }
}
