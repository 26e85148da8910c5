//! Words as people write and read them: values of the wire's enums, numbers of trainings.

/// A value in a word: `JOB_STATE_DONE` without its `prefix` is `done`.
pub fn word(name: &str, prefix: &str) -> String {
    name.trim_start_matches(prefix).to_ascii_lowercase().replace('_', "-")
}

/// A training's name: as it is, or by its number alone, so that `1` and `job-1` are `job-000001`.
///
/// # Errors
/// For what is neither.
pub fn job_id(typed: &str) -> Result<String, String> {
    let number = typed.strip_prefix("job-").unwrap_or(typed);
    let is_number = !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit());
    match number.parse::<u64>() {
        Ok(number) if is_number => Ok(format!("job-{number:06}")),
        _ => Err("write it as job-000001, or its number; `cairn jobs` lists them".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_training_is_named_by_its_number_too() {
        for typed in ["1", "job-1", "job-000001", "000001"] {
            assert_eq!(job_id(typed).as_deref(), Ok("job-000001"), "{typed}");
        }
        assert_eq!(job_id("1234567").as_deref(), Ok("job-1234567"));
        for typed in ["", "job-", "job-x", "town", "+1", "99999999999999999999"] {
            assert!(job_id(typed).unwrap_err().contains("cairn jobs"), "{typed}");
        }
    }
}
