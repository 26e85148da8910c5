//! Which of its cosigned checkpoints a log proves with: the newest, unless it carries fewer cosignatures.
#![cfg(feature = "store")]

use crate::common::{ORIGIN, owner, registry_key, submit};
use cairn_log::{Checkpoint, Note, Registry, RegistryError, cosign, log::store::FaultyStore};

/// A checkpoint with the cosignatures of so many witnesses.
fn cosigned(checkpoint: &str, witnesses: u8) -> String {
    let mut note = Note::parse(checkpoint).unwrap();
    for number in 0..witnesses {
        let line = cosign(&note.text, 1_700_000_000, &format!("w{number}.example"), &owner(100 + number)).unwrap();
        note.signatures.push(line);
    }
    note.to_string()
}

#[test]
fn the_better_note_is_kept() {
    let store = FaultyStore::new();
    let registry =
        Registry::open_store(Box::new(store.clone()), Box::new(store.clone()), registry_key(), ORIGIN).unwrap();
    let grow = |what: &str| {
        submit(&registry, &owner(1), "fern", what).unwrap();
        registry.publish().unwrap();
        registry.checkpoint()
    };
    assert_eq!((registry.cosigned(), registry.cosigned_size()), (None, 0));
    let first = grow("a");
    let takes = |note: &str, keeps: &str| {
        registry.cosign(note).unwrap();
        assert_eq!(registry.cosigned().as_deref(), Some(keeps));
    };
    let (one, two) = (cosigned(&first, 1), cosigned(&first, 2));
    takes(&one, &one);
    takes(&two, &two);
    // Fewer may be too few for somebody's policy: at the same size, and at a newer one.
    takes(&one, &two);
    assert_eq!(registry.published().unwrap().checkpoint, two, "monitors are shown the better one as well");
    let second = grow("b");
    takes(&cosigned(&second, 1), &two);
    assert_eq!(registry.cosigned_size(), 2);
    // What the older note covers is proven under it, the rest under what the log alone signed.
    assert_eq!(registry.tlog_proof(0).unwrap().checkpoint, two);
    assert_eq!(registry.tlog_proof(2).unwrap().checkpoint, second);
    // As many under a newer checkpoint; and nothing older after that, however many.
    let newer = cosigned(&second, 2);
    takes(&newer, &newer);
    takes(&cosigned(&first, 3), &newer);
    assert_eq!((registry.cosigned_size(), registry.tlog_proof(0).unwrap().checkpoint), (4, newer));
}

#[test]
fn what_is_no_checkpoint_of_this_log_is_not_taken() {
    let store = FaultyStore::new();
    let registry =
        Registry::open_store(Box::new(store.clone()), Box::new(store.clone()), registry_key(), ORIGIN).unwrap();
    submit(&registry, &owner(1), "fern", "a").unwrap();
    registry.publish().unwrap();
    let good = cosigned(&registry.checkpoint(), 1);
    let parsed = Checkpoint::verify(&good, &registry.verifier().unwrap()).unwrap();
    let forged = Checkpoint::new(ORIGIN, parsed.size, cairn_log::Digest::of("x")).sign(&registry_key()).unwrap();
    for wrong in [good.replace(ORIGIN, "other.example/log"), good.replacen("\n2\n", "\n3\n", 1), forged.to_string()] {
        let refused = registry.cosign(&wrong).unwrap_err();
        assert!(matches!(refused, RegistryError::Inconsistent { .. }), "{refused}");
    }
    assert_eq!(registry.cosigned(), None);
}
