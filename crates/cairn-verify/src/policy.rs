//! What a trust policy says of a checkpoint: whether enough witnesses cosigned it, and
//! by when.

use cairn_log::format::{
    NoteVerifier, Policy, Quorum,
    policy::{PolicyCheckError, PolicyVerdict},
};

use crate::{code::Code, report::Findings};

/// Judges a signed checkpoint of the log `pinned`, whose own signature was verified before.
pub(crate) fn check(
    policy: &Policy,
    pinned: &NoteVerifier,
    note: &str,
    place: &str,
    findings: &mut Findings,
) -> Option<PolicyVerdict> {
    let expected = "the cosignatures that the policy asks for";
    let verdict = match policy.check_under(note, std::slice::from_ref(pinned)) {
        Ok(verdict) => verdict,
        Err(e @ PolicyCheckError::Cosignature(_)) => {
            findings.add(Code::PolicySignatureInvalid, place, expected, e);
            return None;
        }
        // The log's own signature, which whoever called has reported.
        Err(e) => {
            findings.add(Code::PolicyQuorumMissing, place, expected, e);
            return None;
        }
    };
    let list = |names: Vec<String>| if names.is_empty() { "none".to_owned() } else { names.join(", ") };
    let cosigned = list(verdict.cosigned.iter().map(|(name, time)| format!("{name} at {}", utc(*time))).collect());
    let missing = match verdict.missing.is_empty() {
        true => String::new(),
        false => format!("; not by {}", list(verdict.missing.clone())),
    };
    let got = format!("cosigned by {cosigned}{missing}");
    match verdict.quorum {
        Quorum::Incomplete => findings.add(Code::PolicyQuorumMissing, place, expected, got),
        Quorum::NotRequired => findings.add(Code::PolicyQuorumMet, place, "", format!("none asked for; {got}")),
        Quorum::Complete { not_later_than } => {
            findings.add(Code::PolicyQuorumMet, place, "", got);
            findings.add(Code::TimeNotLaterThan, place, "", format!("{} ({not_later_than})", utc(not_later_than)));
        }
    }
    Some(verdict)
}

/// Unix seconds as date and time of day, UTC (Hinnant, "chrono-Compatible Low-Level Date Algorithms").
pub(crate) fn utc(unix: u64) -> String {
    let (days, seconds) = (unix / 86_400, unix % 86_400);
    let z = days + 719_468;
    let (era, day_of_era) = (z / 146_097, z % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    // Years begin in March here, so that the leap day is a year's last.
    let month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month + 2) / 5 + 1;
    let (year, month) =
        (year_of_era + era * 400 + u64::from(month >= 10), if month < 10 { month + 3 } else { month - 9 });
    let (hour, minute, second) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
}

#[cfg(test)]
mod tests {
    use cairn_log::{Checkpoint, Digest, OwnerKey, WitnessVerifier, cosign, format::Policy};

    use super::*;

    #[test]
    fn who_did_not_cosign_is_told_where_there_is_one() {
        let key = |number: u8| OwnerKey::from_seed(&[number; 32]);
        let pinned = NoteVerifier::new("log", key(1).public()).unwrap();
        let named = |number: u8| format!("w{number} {}", WitnessVerifier::new("w", key(number).public()).unwrap());
        let of = |witnesses: &[u8]| {
            let lines: String = witnesses.iter().map(|w| format!("witness {}\n", named(*w))).collect();
            let mut note = Checkpoint::new("log", 1, Digest::of("root")).sign(&key(1)).unwrap();
            note.signatures.push(cosign(&note.text, 1_700_000_000, "w", &key(2)).unwrap());
            let policy = Policy::parse(format!("log {pinned}\n{lines}quorum w2\n")).unwrap();
            let mut findings = Findings::default();
            check(&policy, &pinned, &note.to_string(), "checkpoint", &mut findings);
            findings.0[0].got.clone()
        };
        assert_eq!(of(&[2]), "cosigned by w2 at 2023-11-14T22:13:20Z");
        assert_eq!(of(&[2, 3]), "cosigned by w2 at 2023-11-14T22:13:20Z; not by w3");
    }

    #[test]
    fn times_are_told_as_dates() {
        for (unix, text) in [
            (0, "1970-01-01T00:00:00Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (951_868_799, "2000-02-29T23:59:59Z"),
            (1_700_000_000, "2023-11-14T22:13:20Z"),
            (4_107_542_400, "2100-03-01T00:00:00Z"),
        ] {
            assert_eq!(utc(unix), text);
        }
    }
}
