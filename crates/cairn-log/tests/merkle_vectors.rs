//! The RFC 6962 cases of transparency-dev/merkle: 98 of inclusion, 98 of consistency, right ones and wrong ones.
//!
//! Every case is run and must agree, with one exception that is ours on purpose: the case "sizes are equal (one)
//! and proof is empty" has the 12 bytes "don't care 2" for both its roots and is accepted by its authors. Ours refuses every hash
//! that is not 32 bytes, so the case is checked twice: refused as it stands, accepted with 32-byte roots in the same places.

use std::{fs, path::Path};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use cairn_log::{
    Digest, ProofError,
    format::merkle::{verify_consistency, verify_inclusion},
};
use serde_json::Value;

fn cases(folder: &Path, found: &mut Vec<(String, Value)>) {
    let mut paths: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    for path in paths {
        if path.is_dir() {
            cases(&path, found);
        } else {
            let case = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
            found.push((path.display().to_string(), case));
        }
    }
}

fn bytes(value: &Value) -> Vec<u8> {
    STANDARD.decode(value.as_str().unwrap_or_default()).unwrap()
}

fn hash(value: &Value) -> Result<Digest, ProofError> {
    Ok(Digest::try_from(bytes(value).as_slice())?)
}

/// `null` stands for an empty proof.
fn proof(case: &Value) -> Result<Vec<Digest>, ProofError> {
    case["proof"].as_array().into_iter().flatten().map(hash).collect()
}

fn inclusion(case: &Value) -> Result<(), ProofError> {
    let (index, size) = (case["leafIdx"].as_u64().unwrap(), case["treeSize"].as_u64().unwrap());
    verify_inclusion(&hash(&case["leafHash"])?, index, size, &proof(case)?, &hash(&case["root"])?)
}

fn consistency(case: &Value) -> Result<(), ProofError> {
    let (from, to) = (case["size1"].as_u64().unwrap(), case["size2"].as_u64().unwrap());
    verify_consistency(from, to, &proof(case)?, &hash(&case["root1"])?, &hash(&case["root2"])?)
}

#[test]
fn all_inclusion_cases() {
    let Some(folder) = crate::common::vectors("all_inclusion_cases") else { return };
    let mut found = Vec::new();
    cases(&folder.join("inclusion"), &mut found);
    assert_eq!(found.len(), 98);
    for (name, case) in found {
        let result = inclusion(&case);
        assert_eq!(result.is_err(), case["wantErr"].as_bool().unwrap(), "{name}: {result:?}");
    }
}

#[test]
fn all_consistency_cases() {
    let Some(folder) = crate::common::vectors("all_consistency_cases") else { return };
    let mut found = Vec::new();
    cases(&folder.join("consistency"), &mut found);
    assert_eq!(found.len(), 98);
    let mut stand_ins = 0;
    for (name, mut case) in found {
        let want_error = case["wantErr"].as_bool().unwrap();
        if !want_error && bytes(&case["root1"]).len() != 32 {
            stand_ins += 1;
            assert!(matches!(consistency(&case), Err(ProofError::Hash(_))), "{name}");
            for root in ["root1", "root2"] {
                let mut padded = bytes(&case[root]);
                padded.resize(32, 0);
                case[root] = Value::String(STANDARD.encode(padded));
            }
        }
        let result = consistency(&case);
        assert_eq!(result.is_err(), want_error, "{name}: {result:?}");
    }
    assert_eq!(stand_ins, 1);
}
