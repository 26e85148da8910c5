//! `docs/reference/api.md`, made from the contract as it was compiled, with its comments. A test writes and compares it; the
//! program does not carry this.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use cairn_api::v1::FILE_DESCRIPTOR_SET;
use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, EnumDescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet};

use crate::auth::roles::{self, Need};

/// What stands above the services.
const HEAD: &str = "# The gRPC contract\n\nEvery call and message of `proto/cairn/v1`, package `cairn.v1`, from the compiled contract. \
    The daemon serves reflection and\nhealth beside it, so `grpcurl -plaintext 127.0.0.1:7341 list` works. Each call says who may \
    make it where `access.mode` is\n`accounts`; [the guide](../guide/access.md) has the roles. Errors are gRPC codes with a message \
    for people.\n";

/// Comments by the path of what they stand before (descriptor.proto, `SourceCodeInfo.Location.path`).
type Comments = BTreeMap<Vec<i32>, String>;

fn comments(file: &FileDescriptorProto) -> Comments {
    let places = file.source_code_info.iter().flat_map(|info| &info.location);
    let said = places.filter_map(|place| Some((place.path.clone(), place.leading_comments.as_ref()?)));
    said.map(|(path, text)| (path, text.split_whitespace().collect::<Vec<_>>().join(" "))).collect()
}

fn who(need: Need) -> &'static str {
    match need {
        Need::Anyone => "anybody",
        Need::Read => "anybody, or any account where reading is closed",
        Need::Account => "any account",
        Need::Contribute => "contributor, curator, operator",
        Need::Inspect => "the scene's owner, curator, auditor, operator",
        Need::Change => "the scene's owner, curator, operator",
        Need::Curate => "curator, operator",
        Need::Oversee => "auditor, operator",
        Need::Operate => "operator",
    }
}

/// The page.
fn page() -> String {
    let set = FileDescriptorSet::decode(FILE_DESCRIPTOR_SET).unwrap();
    let mut text = HEAD.to_owned();
    for file in set.file.iter().filter(|file| file.package() == "cairn.v1") {
        let comments = comments(file);
        let said = |path: &[i32]| comments.get(path).map_or("", String::as_str);
        // Numbers of fields of FileDescriptorProto: 4 messages, 5 enums, 6 services.
        for (at, service) in (0..).zip(&file.service) {
            write!(text, "\n## {}\n\n{}\n", service.name(), said(&[6, at])).unwrap();
            for (which, method) in (0..).zip(&service.method) {
                let path = format!("/{}.{}/{}", file.package(), service.name(), method.name());
                let need = roles::need(&path).unwrap();
                let (streams_in, streams_out) = (method.client_streaming(), method.server_streaming());
                let takes = format!("{}{}", if streams_in { "stream of " } else { "" }, link(method.input_type()));
                let gives = format!("{}{}", if streams_out { "stream of " } else { "" }, link(method.output_type()));
                let about = said(&[6, at, 2, which]);
                write!(text, "\n### {}.{}\n\n{about}\n\n", service.name(), method.name()).unwrap();
                write!(text, "- takes {takes}, gives {gives}\n- for: {}\n", who(need)).unwrap();
            }
        }
        if !file.message_type.is_empty() || !file.enum_type.is_empty() {
            write!(text, "\n## Messages of {}\n", file.name()).unwrap();
        }
        for (at, message) in (0..).zip(&file.message_type) {
            of_message(&mut text, message, said(&[4, at]), &|field| said(&[4, at, 2, field]).to_owned());
        }
        for (at, choices) in (0..).zip(&file.enum_type) {
            of_enum(&mut text, choices, said(&[5, at]), &|value| said(&[5, at, 2, value]).to_owned());
        }
    }
    text
}

fn of_message(text: &mut String, message: &DescriptorProto, about: &str, said: &dyn Fn(i32) -> String) {
    write!(text, "\n### {}\n\n", message.name()).unwrap();
    if !about.is_empty() {
        write!(text, "{about}\n\n").unwrap();
    }
    if message.field.is_empty() {
        text.push_str("It has no fields.\n");
    }
    for (at, field) in (0..).zip(&message.field) {
        let choice = match field.oneof_index {
            Some(index) if !field.proto3_optional() => {
                format!(", one of `{}`", message.oneof_decl[index as usize].name())
            }
            _ => String::new(),
        };
        let about = said(at);
        let end = if about.is_empty() { String::new() } else { format!(": {about}") };
        writeln!(text, "- `{}` ({}{choice}){end}", field.name(), type_of(field)).unwrap();
    }
}

fn of_enum(text: &mut String, choices: &EnumDescriptorProto, about: &str, said: &dyn Fn(i32) -> String) {
    write!(text, "\n### {}\n\n", choices.name()).unwrap();
    if !about.is_empty() {
        write!(text, "{about}\n\n").unwrap();
    }
    for (at, value) in (0..).zip(&choices.value) {
        let about = said(at);
        let end = if about.is_empty() { String::new() } else { format!(": {about}") };
        writeln!(text, "- `{}` = {}{end}", value.name(), value.number()).unwrap();
    }
}

fn type_of(field: &FieldDescriptorProto) -> String {
    let name = match field.r#type() {
        Type::Message | Type::Enum => link(field.type_name()),
        other => other.as_str_name().trim_start_matches("TYPE_").to_lowercase(),
    };
    match field.label() {
        Label::Repeated => format!("list of {name}"),
        _ if field.proto3_optional() => format!("{name}, optional"),
        _ => name,
    }
}

/// A message's name, leading to its section.
fn link(full_name: &str) -> String {
    let name = full_name.rsplit('.').next().unwrap_or(full_name);
    format!("[{name}](#{})", name.to_lowercase())
}

#[test]
fn the_reference_of_calls_is_what_the_contract_says() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/reference/api.md");
    let wanted = page();
    if std::env::var_os("CAIRN_WRITE_DOCS").is_some() {
        std::fs::write(&path, &wanted).unwrap();
    }
    let there = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(there == wanted, "{} is old: CAIRN_WRITE_DOCS=1 cargo test -p cairn-service contract", path.display());
}

#[test]
fn every_call_and_message_says_what_it_is() {
    let page = page();
    let mut silent = Vec::new();
    for section in page.split("\n### ").skip(1) {
        let (name, rest) = section.split_once('\n').unwrap();
        // A call's comment comes first, or its list does.
        if name.contains('.') && rest.trim_start().starts_with("- takes") {
            silent.push(name.to_owned());
        }
    }
    assert!(silent.is_empty(), "no comment in proto/ on {silent:?}");
}
