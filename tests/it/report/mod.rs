//! Reports as HTML pages, opened in a browser.

mod bench_page;
mod cost_page;
mod gallery_page;
mod verify_page;
