//! Rectangle of an image's pixels.

/// Rectangle of an image's pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rectangle {
    /// First column, counted from the left.
    pub x: u32,
    /// First row, counted from the top.
    pub y: u32,
    /// Number of columns, in pixels.
    pub width: u32,
    /// Number of rows, in pixels.
    pub height: u32,
}

impl Rectangle {
    /// Returns whether all of `other` lies in this rectangle.
    pub(super) fn holds(&self, other: &Rectangle) -> bool {
        let within = |start: u32, size: u32, inner: u32, inner_size: u32| {
            let end = |start: u32, size: u32| u64::from(start) + u64::from(size);
            start <= inner && end(inner, inner_size) <= end(start, size)
        };
        within(self.x, self.width, other.x, other.width) && within(self.y, self.height, other.y, other.height)
    }
}
