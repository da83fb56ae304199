//! Endings of the names of photos.

use std::path::Path;

/// Extensions of the image formats that are read.
pub(super) const EXTENSIONS: [&str; 14] = [
    "png", "jpg", "jpeg", "webp", "exr", "hdr", "bmp", "PNG", "JPG", "JPEG", "WEBP", "EXR", "HDR",
    "BMP",
];

/// Endings of formats that photos are converted from: a photo of the same name is meant by theirs.
const CONVERTED: [&str; 4] = ["tif", "tiff", "TIF", "TIFF"];

/// True for a path with one of these endings.
fn has_ending(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().and_then(|e| e.to_str());
    ending.is_some_and(|e| endings.contains(&e))
}

/// True for a name that ends like an image file, whether its format is read or not.
pub(super) fn is_image(path: &Path) -> bool {
    is_photo(path) || is_converted(path)
}

/// True for a file that has the extension of a format that photos are converted from.
pub(super) fn is_converted(path: &Path) -> bool {
    has_ending(path, &CONVERTED)
}

/// True for a file that has the extension of an image format that is read.
pub(super) fn is_photo(path: &Path) -> bool {
    has_ending(path, &EXTENSIONS)
}
