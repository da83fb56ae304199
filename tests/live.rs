//! `view` and `train --view`: the server over real sockets, the page in a browser, and training that nobody can tell was watched.

mod browser;
mod client;
mod operated;
mod program;
mod server;
mod training;
