//! Tables of pages, with rows that a filter can hide.

use serde::Serialize;

use crate::report::text::table::group_thousands;

/// Column with its heading and alignment.
#[derive(Clone, Debug)]
pub enum Column<'a> {
    /// Text column, aligned to the left.
    Words(&'a str),
    /// Number column, aligned to the right.
    Numbers(&'a str),
}

/// Table cell, or part of a paragraph.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Cell {
    text: String,
    /// Text in a fainter colour behind the other.
    #[serde(skip_serializing_if = "String::is_empty")]
    range: String,
    /// CSS class of the background; empty for none.
    #[serde(skip_serializing_if = "str::is_empty")]
    badge: &'static str,
    /// Name of the element that the text links to; empty for none.
    #[serde(skip_serializing_if = "String::is_empty")]
    to: String,
    /// CSS class of text that wraps into further lines or is cut off at one line; empty for one line.
    #[serde(skip_serializing_if = "str::is_empty")]
    layout: &'static str,
}

impl Cell {
    /// Returns a cell of plain text in one line.
    pub fn text(text: &str) -> Cell {
        Cell {
            text: text.to_owned(),
            ..Cell::default()
        }
    }

    /// Returns a cell of plain text that wraps into several lines.
    pub fn wrapped(text: &str) -> Cell {
        Cell {
            layout: "wrap",
            ..Cell::text(text)
        }
    }

    /// Returns a cell of plain text that is cut off at one line; the tooltip has the complete text.
    pub fn short(text: &str) -> Cell {
        Cell {
            layout: "short",
            ..Cell::text(text)
        }
    }

    /// Returns a cell of a value with its range in a fainter colour.
    pub fn with_range(value: &str, range: &str) -> Cell {
        Cell {
            range: range.to_owned(),
            ..Cell::text(value)
        }
    }

    /// Returns a cell of a number with narrow no-break spaces between thousands.
    pub fn count(number: u64) -> Cell {
        Cell::text(&group_thousands(number).replace(' ', "\u{202f}"))
    }

    /// Returns a word in the colour of its class that links to the element `to` of the page.
    pub fn badge_link(word: &str, class: &'static str, to: &str) -> Cell {
        Cell {
            badge: class,
            ..Cell::link(word, to)
        }
    }

    /// Returns text that links to the element `to` of the page.
    pub fn link(text: &str, to: &str) -> Cell {
        Cell {
            to: to.to_owned(),
            ..Cell::text(text)
        }
    }

    /// Returns a word on a background in the colour of its class.
    pub fn badge(word: &str, class: &'static str) -> Cell {
        Cell {
            badge: class,
            ..Cell::text(word)
        }
    }
}

/// Table with its columns and rows.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    class: &'static str,
    /// Headings of the columns, with true for numbers.
    columns: Vec<(String, bool)>,
    rows: Vec<TableRow>,
}

#[derive(Clone, Debug, Serialize)]
struct TableRow {
    verdict: String,
    item: String,
    cells: Vec<Cell>,
}

impl Table {
    /// Returns a table without rows; `class` is its CSS class.
    pub fn new(class: &'static str, columns: &[Column]) -> Table {
        let columns = columns.iter().map(|column| match column {
            Column::Words(name) => ((*name).to_owned(), false),
            Column::Numbers(name) => ((*name).to_owned(), true),
        });
        Table {
            class,
            columns: columns.collect(),
            rows: Vec::new(),
        }
    }

    /// Adds a row with `verdict` as its key for the filter; `item` is the page's section that the row belongs to.
    pub fn row(&mut self, (verdict, item): (&str, &str), cells: &[Cell]) {
        self.rows.push(TableRow {
            verdict: verdict.to_owned(),
            item: item.to_owned(),
            cells: cells[..cells.len().min(self.columns.len())].to_vec(),
        });
    }
}
