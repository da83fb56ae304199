//! 8-bit photos, planar.

/// An 8-bit image, planar: `data[(c·height + y)·width + x]`. With 4 channels the colours are premultiplied by the alpha
/// plane (channel 3), so that the photo over a background b is `rgb + (1 − alpha)·b`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Photo {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// 3 (RGB) or 4 (premultiplied RGBA).
    pub channels: u32,
    /// Planes, `channels × height × width` bytes.
    pub data: Vec<u8>,
}
