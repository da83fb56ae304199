//! A scene in a browser, rendered by this program's kernels: a page over HTTP on a port of this machine, its pictures as JPEG. Only
//! who knows the token is answered.
//!
//! | request | answer |
//! |---|---|
//! | `GET /` | the page |
//! | `GET /frame` | a picture: `width`, `height`, `mode` (`color`, `depth`, `error`, of a run `births`), and `view`, or `lens`, `rotation` and `center` |
//! | `GET /photo` | the photo of a `view` at `width` × `height` |
//! | `GET /depth` | the depth at pixel `at` of such a picture |
//! | `GET /status` | of a run: its state, and its curves after iteration `since` |
//! | `POST /pause`, `/continue`, `/checkpoint`, `/stop` | of a run: what it says |
//!
//! Connections have threads of their own, which ask the thread that has the device through a desk; it answers when it has the time.

mod ask;
mod curves;
mod desk;
pub mod http;
mod page;
mod paint;
mod server;
mod studio;
mod watch;

pub use page::LivePage;
pub use paint::{Property, colors};
pub use server::{Door, Server, USUAL_PORT};
pub use studio::Scenery;
pub use watch::LARGEST_LIVE;
pub(crate) use watch::Watch;
