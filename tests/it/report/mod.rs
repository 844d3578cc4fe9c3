//! Reports as HTML pages, opened in a browser.

mod bench_page;
mod charts;
mod cost_page;
mod gallery_page;
mod verify_page;
