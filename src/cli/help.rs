//! `whit help`, `whit man` and `whit completions`: what describes the program itself.

use std::io::{self, IsTerminal, Write};
use std::path::Path;
use std::process::{Command, Stdio};

use clap::CommandFactory;

use whit::manual::{TOPICS, topic};

use super::args::{Args, CompletionsArgs, HelpArgs, ManArgs};
use super::failure::Failure;
use super::output;

/// Prints a page of the manual, the flags of a command, or without a topic the list of both.
pub(super) fn run(args: &HelpArgs) -> Result<(), Failure> {
    let mut command = Args::command();
    let Some(name) = &args.topic else {
        let overview = command.render_long_help().to_string();
        return output::print(&format!("{overview}\n{}", topic_list()));
    };
    if let Some(page) = topic(name) {
        return show(page.text);
    }
    // Subcommands take their usage line from the parent once it is built.
    command.build();
    match command.find_subcommand_mut(name) {
        Some(found) => show(&found.render_long_help().to_string()),
        None => Err(Failure::Input(format!(
            "there is no topic `{name}`; topics are the commands and {}",
            TOPICS
                .iter()
                .map(|topic| topic.name)
                .collect::<Vec<_>>()
                .join(", ")
        ))),
    }
}

/// Writes man pages of the program and of each command into a folder.
pub(super) fn write_man_pages(args: &ManArgs) -> Result<(), Failure> {
    if !args.folder.is_dir() {
        return Err(Failure::Input(format!(
            "there is no folder `{}`; create it first",
            args.folder.display()
        )));
    }
    let mut command = Args::command();
    command.build();
    write_man_page(&args.folder, "whit.1", command.clone())?;
    for subcommand in command.get_subcommands() {
        let name = format!("whit-{}", subcommand.get_name());
        let file = format!("{name}.1");
        // clap asks for names of static lifetime; a process writes these once.
        write_man_page(
            &args.folder,
            &file,
            subcommand.clone().name(String::leak(name) as &str),
        )?;
    }
    Ok(())
}

/// Writes one man page, whole or not at all.
fn write_man_page(folder: &Path, file: &str, command: clap::Command) -> Result<(), Failure> {
    let mut page = Vec::new();
    clap_mangen::Man::new(command)
        .render(&mut page)
        .map_err(|error| Failure::Work(format!("could not make {file}: {error}")))?;
    output::write_text(&folder.join(file), &String::from_utf8_lossy(&page))
}

/// Prints the completions of a shell.
pub(super) fn print_completions(args: &CompletionsArgs) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Args::command(), "whit", &mut script);
    output::print(&String::from_utf8_lossy(&script))
}

/// Returns the names and titles of the manual's pages, one a line.
fn topic_list() -> String {
    let width = TOPICS.iter().map(|topic| topic.name.len()).max().unwrap_or(0);
    let mut list = String::from("Topics of `whit help TOPIC`:\n");
    for topic in TOPICS {
        list += &format!("  {:width$}  {}\n", topic.name, topic.title());
    }
    list
}

/// Shows a text through the user's pager if standard output is a terminal, else prints it.
fn show(text: &str) -> Result<(), Failure> {
    if io::stdout().is_terminal() && page(text).is_ok() {
        return Ok(());
    }
    output::print(text)
}

/// Hands a text to `$PAGER`, or to `less`, which leaves short texts on the screen.
fn page(text: &str) -> io::Result<()> {
    let pager = std::env::var("PAGER").unwrap_or_else(|_| "less -FRX".to_owned());
    let mut words = pager.split_whitespace();
    let program = words.next().ok_or(io::ErrorKind::NotFound)?;
    let mut child = Command::new(program).args(words).stdin(Stdio::piped()).spawn()?;
    if let Some(mut stdin) = child.stdin.take() {
        // A reader that quits early is no failure.
        let _ = stdin.write_all(text.as_bytes());
    }
    child.wait().map(drop)
}
