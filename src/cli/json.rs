//! Answers as JSON, for programs: the message that the daemon sends, field by field, under the names of `proto/cairn/v1`.
//!
//! Bytes are lower-case hexadecimal, values of enums the words that text answers use, numbers numbers; but integers of 64
//! bits are decimal strings, as in the JSON mapping of proto3: many readers of JSON have doubles only, and seeds may exceed
//! 2^53. A field that is not set is `null`; of a `oneof` only what is set is there.

use anyhow::Context as _;
use cairn_api::v1::FILE_DESCRIPTOR_SET;
use prost::{Message, Name};
use prost_reflect::{
    DescriptorPool, DynamicMessage, EnumDescriptor, FieldDescriptor, Kind, ReflectMessage as _, Value as Field,
};
use serde_json::{Map, Value};

use super::words::word;

/// `--json`.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub struct Json {
    /// Print the answer as JSON, for programs
    #[arg(long)]
    pub json: bool,
}

/// Prints a message.
///
/// # Errors
/// As [`of`].
pub fn print<M: Message + Name>(message: &M) -> anyhow::Result<()> {
    print_value(&of(message)?)
}

/// Prints a message in one line.
///
/// # Errors
/// As [`of`].
pub fn print_line<M: Message + Name>(message: &M) -> anyhow::Result<()> {
    println!("{}", of(message)?);
    Ok(())
}

/// Prints what is JSON already.
///
/// # Errors
/// None for values of JSON.
pub fn print_value(value: &Value) -> anyhow::Result<()> {
    println!("{}", serde_json::to_string_pretty(value)?);
    Ok(())
}

/// A message as JSON.
///
/// # Errors
/// For a message that is not of the contract.
pub fn of<M: Message + Name>(message: &M) -> anyhow::Result<Value> {
    let contract = DescriptorPool::decode(FILE_DESCRIPTOR_SET)?;
    let name = M::full_name();
    let descriptor =
        contract.get_message_by_name(&name).with_context(|| format!("{name} is no message of the contract"))?;
    Ok(object(&DynamicMessage::decode(descriptor, &message.encode_to_vec()[..])?))
}

fn object(message: &DynamicMessage) -> Value {
    let mut fields = Map::new();
    for field in message.descriptor().fields() {
        let is_set = message.has_field(&field);
        // `optional` fields are oneofs of one, too.
        let is_choice = field.containing_oneof().is_some_and(|choices| !choices.is_synthetic());
        match (is_set, is_choice, field.supports_presence()) {
            (false, true, _) => {}
            (false, false, true) => drop(fields.insert(field.name().to_owned(), Value::Null)),
            _ => drop(fields.insert(field.name().to_owned(), value(&message.get_field(&field), &field))),
        }
    }
    Value::Object(fields)
}

fn value(field: &Field, descriptor: &FieldDescriptor) -> Value {
    match field {
        Field::Bool(value) => (*value).into(),
        Field::I32(value) => (*value).into(),
        Field::I64(value) => value.to_string().into(),
        Field::U32(value) => (*value).into(),
        Field::U64(value) => value.to_string().into(),
        // The shortest that reads as the same number, not all digits of a nearby double.
        Field::F32(value) => value.to_string().parse::<f64>().map_or(Value::Null, Value::from),
        Field::F64(value) => (*value).into(),
        Field::String(value) => value.as_str().into(),
        Field::Bytes(bytes) => bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>().into(),
        Field::EnumNumber(number) => match descriptor.kind() {
            Kind::Enum(choices) => of_enum(&choices, *number),
            _ => (*number).into(),
        },
        Field::Message(message) => object(message),
        Field::List(values) => values.iter().map(|one| value(one, descriptor)).collect(),
        // The contract has none.
        Field::Map(_) => Value::Null,
    }
}

/// `JOB_STATE_DONE` of `JobState` is `done`.
fn of_enum(choices: &EnumDescriptor, number: i32) -> Value {
    let Some(choice) = choices.get_value(number) else { return number.into() };
    let mut prefix = String::new();
    for letter in choices.name().chars() {
        if letter.is_uppercase() && !prefix.is_empty() {
            prefix.push('_');
        }
        prefix.extend(letter.to_uppercase());
    }
    word(choice.name(), &format!("{prefix}_")).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use cairn_api::v1;
    use serde_json::json;

    #[test]
    fn a_message_has_its_fields_by_name_and_its_enums_in_words() {
        let progress = v1::Progress { stage: "base field".into(), step: 3, total: 9, ..v1::Progress::default() };
        let job = v1::Job {
            id: "job-000001".into(),
            state: v1::JobState::Running.into(),
            seed: u64::MAX,
            progress: Some(progress),
            ..v1::Job::default()
        };
        let said = of(&job).unwrap();
        assert_eq!(said["state"], "running");
        assert_eq!(said["seed"], "18446744073709551615");
        assert_eq!((&said["progress"]["step"], &said["notes"]), (&json!("3"), &json!([])));
        assert_eq!(of(&v1::Job::default()).unwrap()["progress"], Value::Null);
    }

    #[test]
    fn of_a_choice_there_is_what_was_chosen_and_bytes_are_hexadecimal() {
        use v1::identify_response::Answer;
        let answer = v1::IdentifyResponse {
            answer: Some(Answer::Unmarked(v1::Unmarked {})),
            probabilities: vec![0.1],
            ..v1::IdentifyResponse::default()
        };
        let said = of(&answer).unwrap();
        assert_eq!((&said["unmarked"], said.get("identity")), (&json!({}), None));
        assert_eq!(said["probabilities"], json!([0.1]));
        let account = v1::Account { public_key: vec![0, 171].into(), ..v1::Account::default() };
        let said = of(&account).unwrap();
        assert_eq!((&said["public_key"], &said["ended_by"]), (&json!("00ab"), &Value::Null));
        assert_eq!(said["role"], "unspecified");
    }
}
