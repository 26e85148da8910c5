//! Words and sentences that people read: in the documents, in the help of commands, and in
//! messages. Comments are for those who change the code, and are not looked at.

use std::path::Path;

use proc_macro2::{Delimiter, TokenStream, TokenTree};

use super::{packages, root, sources};

/// Words that need two readings, or hide who acts. What to say instead: owner, contributor, caller,
/// the key's holder; registered; a plain sentence.
const UNCLEAR: [&str; 6] = ["somebody", "whoever", "laid over", "goes on as", "stands over", "before nothing"];

/// Words of a sentence at most. A list or a quotation counts as one sentence per entry.
const MAX_WORDS: usize = 40;

/// The documents that people read, without what is generated.
fn documents() -> Vec<(String, String)> {
    let mut found: Vec<_> =
        ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md"].map(|name| root().join(name)).into();
    let mut folders = vec![root().join("docs")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|end| end == "md") && !path.ends_with("docs/results.md") {
                found.push(path);
            }
        }
    }
    assert!(found.len() > 40, "only {} documents found", found.len());
    let read = |path: std::path::PathBuf| (named(&path), std::fs::read_to_string(&path).unwrap());
    found.into_iter().map(read).collect()
}

fn named(path: &Path) -> String {
    path.strip_prefix(root()).unwrap_or(path).display().to_string()
}

/// The text literals of a file outside tests; with `help` also its documentation, which `clap` prints.
fn literals(text: &str, help: bool) -> Vec<String> {
    fn walk(stream: TokenStream, help: bool, found: &mut Vec<String>) {
        let (mut is_doc, mut in_tests) = (false, false);
        for token in stream {
            match token {
                // Up to its body, or its end without one, an item of tests is left out.
                TokenTree::Group(group) if in_tests => in_tests = group.delimiter() != Delimiter::Brace,
                TokenTree::Punct(mark) if in_tests => in_tests = mark.as_char() != ';',
                _ if in_tests => {}
                TokenTree::Ident(name) => is_doc = name == "doc",
                TokenTree::Literal(literal) => {
                    if let (Ok(text), true) = (syn::parse_str::<syn::LitStr>(&literal.to_string()), help || !is_doc) {
                        found.push(text.value());
                    }
                }
                TokenTree::Group(group) => {
                    in_tests = group.delimiter() == Delimiter::Bracket
                        && group.stream().to_string().replace(' ', "") == "cfg(test)";
                    walk(group.stream(), help, found);
                }
                TokenTree::Punct(_) => {}
            }
        }
    }
    let mut found = Vec::new();
    walk(text.parse().unwrap_or_else(|e| panic!("{e}")), help, &mut found);
    found
}

fn unclear(text: &str) -> Vec<&'static str> {
    let text = text.to_lowercase();
    let is_word = |at: usize, word: &str| {
        let letter = |c: Option<char>| c.is_some_and(char::is_alphanumeric);
        !letter(text[..at].chars().next_back()) && !letter(text[at + word.len()..].chars().next())
    };
    UNCLEAR.into_iter().filter(|word| text.match_indices(word).any(|(at, _)| is_word(at, word))).collect()
}

/// The sentences of a document, without code blocks, tables and headings.
fn sentences(markdown: &str) -> Vec<String> {
    let mut blocks = vec![String::new()];
    let mut in_code = false;
    for line in markdown.lines() {
        let line = line.trim();
        if line.starts_with("```") {
            in_code = !in_code;
        }
        let stands_alone = in_code || line.starts_with(['|', '#', '`', '<']);
        let begins = line.is_empty()
            || line.starts_with("- ")
            || line.starts_with("* ")
            || line.split_once(". ").is_some_and(|(number, _)| number.parse::<u32>().is_ok());
        if stands_alone || begins {
            blocks.push(String::new());
        }
        if !stands_alone || (line.starts_with('`') && !in_code && !line.starts_with("```")) {
            let block = blocks.last_mut().unwrap();
            block.push_str(line);
            block.push(' ');
        }
    }
    let ends = |block: &String| -> Vec<String> {
        let mut found = vec![String::new()];
        for word in block.split_whitespace() {
            let sentence = found.last_mut().unwrap();
            sentence.push_str(word);
            sentence.push(' ');
            let bare = word.trim_end_matches([')', '*', '`', '"']);
            if bare.ends_with(['.', '?', '!', ':', ';']) {
                found.push(String::new());
            }
        }
        found
    };
    blocks.iter().flat_map(ends).collect()
}

#[test]
fn what_people_read_has_plain_words() {
    let mut faults = Vec::new();
    for (name, text) in documents() {
        // Between backticks stand names, which are another file's.
        let text: Vec<&str> = text.split('`').step_by(2).collect();
        faults.extend(unclear(&text.concat()).iter().map(|word| format!("{name}: {word:?}")));
    }
    for (package, folder) in packages() {
        let mut files = Vec::new();
        sources(&folder.join("src"), &mut files);
        files.retain(|file| !file.ends_with("tests.rs") && !named(file).ends_with("_tests.rs"));
        for file in files {
            let text = std::fs::read_to_string(&file).unwrap();
            for literal in literals(&text, package == "cairn") {
                faults
                    .extend(unclear(&literal).iter().map(|word| format!("{}: {word:?} in {literal:?}", named(&file))));
            }
        }
    }
    assert!(faults.is_empty(), "say who acts, and what is meant:\n{}", faults.join("\n"));
}

#[test]
fn sentences_of_documents_can_be_read_aloud() {
    let mut faults = Vec::new();
    for (name, text) in documents() {
        for sentence in sentences(&text) {
            let words = sentence.split_whitespace().filter(|word| word.contains(char::is_alphanumeric)).count();
            if words > MAX_WORDS {
                faults.push(format!("{name}: {words} words: {sentence}"));
            }
        }
    }
    assert!(faults.is_empty(), "at most {MAX_WORDS} words a sentence:\n{}", faults.join("\n"));
}

#[test]
fn unclear_words_and_long_sentences_are_found() {
    assert_eq!(unclear("Contest somebody's record"), ["somebody"]);
    assert_eq!(unclear("a picture laid over the field; whoever"), ["whoever", "laid over"]);
    assert_eq!(unclear("inlaid overall, whoeverly"), Vec::<&str>::new());
    assert_eq!(literals("/// whoever\nfn f() { g(\"a\") } #[cfg(test)] mod t { \"b\" }", false), ["a"]);
    assert_eq!(literals("/// A key.\nstruct S;", true), [" A key."]);
    let long = format!(
        "Short one. {}end.\n\n| {} |\n\n```\n{}\n```\n",
        "word ".repeat(41),
        "cell ".repeat(50),
        "code ".repeat(50)
    );
    let counts: Vec<usize> = sentences(&long).iter().map(|s| s.split_whitespace().count()).filter(|n| *n > 0).collect();
    assert_eq!(counts, [2, 42]);
}
