//! Quotas: arithmetic, the rolling day, and what a process that dies leaves.

use super::*;

const LIMITS: Limits =
    Limits { bytes: 100, views: 10, training_seconds: 60, queued_jobs: 2, records: 5, records_per_day: 3 };

fn owner(name: &str) -> Digest {
    Digest::of(name)
}

fn charge(bytes: u64, views: u64) -> Charge {
    Charge { bytes, views }
}

fn refused(result: Result<(), AccessError>) -> QuotaError {
    match result {
        Err(AccessError::Quota(error)) => error,
        other => panic!("{other:?}"),
    }
}

struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn open(&self) -> Arc<Quotas> {
        Arc::new(Quotas::open(self.0.path().join("usage.json")).unwrap())
    }
}

#[test]
fn charges_add_up_and_refusals_name_quota_limit_used_and_what_frees_it() {
    let place = Place::new();
    let quotas = place.open();
    let ada = owner("ada");
    quotas.charge(&ada, &LIMITS, "town", charge(60, 4)).unwrap();
    quotas.charge(&ada, &LIMITS, "well", charge(40, 4)).unwrap();
    let over = refused(quotas.charge(&ada, &LIMITS, "mill", charge(1, 1)));
    assert_eq!((over.kind, over.limit, over.used, over.needed), (Kind::Bytes, 100, 100, 1));
    assert_eq!(
        over.to_string(),
        "the owner's quota `bytes` is 100: 100 used, 1 more asked for; deleting a scene frees what it takes, removing views what they take"
    );
    assert_eq!(refused(quotas.charge(&ada, &LIMITS, "mill", charge(0, 3))).kind, Kind::Views);
    assert_eq!(refused(quotas.charge(&ada, &LIMITS, "mill", charge(u64::MAX, 1))).kind, Kind::Bytes);
    // What is refused leaves nothing, and takes nothing away.
    assert_eq!(place.open().usage(&ada, 0), Usage { bytes: 100, views: 8, ..Usage::default() });
    // Another owner has their own; the same item again replaces; releasing twice is releasing once.
    quotas.charge(&owner("bob"), &LIMITS, "mill", charge(100, 10)).unwrap();
    quotas.charge(&ada, &LIMITS, "town", charge(10, 1)).unwrap();
    assert_eq!(quotas.usage(&ada, 0).bytes, 50);
    for _ in 0..2 {
        quotas.release(&ada, "well").unwrap();
        assert_eq!(quotas.usage(&ada, 0), Usage { bytes: 10, views: 1, ..Usage::default() });
    }
    // 0 is no limit.
    quotas.charge(&ada, &Limits::default(), "huge", charge(u64::MAX, u64::MAX)).unwrap();
    assert_eq!(quotas.usage(&ada, 0).bytes, u64::MAX);
}

#[test]
fn training_is_counted_over_a_rolling_day() {
    let place = Place::new();
    let quotas = place.open();
    let ada = owner("ada");
    let noon = 1_000_000 * HOUR_S;
    assert_eq!(quotas.seconds_left(&ada, &LIMITS, noon), Some(60.0));
    quotas.spend(&ada, 20.25, noon).unwrap();
    quotas.spend(&ada, 20.0, noon + 2 * HOUR_S).unwrap();
    assert_eq!(quotas.seconds_left(&ada, &LIMITS, noon + 2 * HOUR_S), Some(19.75));
    assert_eq!(quotas.check_training(&ada, &LIMITS, noon + 2 * HOUR_S), Ok(()));
    // More than there was: it is spent all the same.
    quotas.spend(&ada, 40.0, noon + 2 * HOUR_S).unwrap();
    let over = quotas.check_training(&ada, &LIMITS, noon + 3 * HOUR_S).unwrap_err();
    assert_eq!((over.kind, over.used, over.frees), (Kind::TrainingSeconds, 81, Frees::At(noon + 24 * HOUR_S)));
    assert!(over.to_string().contains("`training_seconds` is 60: 81 used"), "{over}");
    // After a restart the same, until the first hour is a day old, and then the second.
    let quotas = place.open();
    assert!(quotas.check_training(&ada, &LIMITS, noon + 24 * HOUR_S - 1).is_err());
    assert_eq!(quotas.usage(&ada, noon + 24 * HOUR_S).training_seconds, 60);
    assert!(quotas.check_training(&ada, &LIMITS, noon + 26 * HOUR_S - 1).is_err());
    assert_eq!(quotas.seconds_left(&ada, &LIMITS, noon + 26 * HOUR_S), Some(60.0));
    // What is forgiven leaves the file with the next that is spent.
    quotas.spend(&ada, 1.0, noon + 26 * HOUR_S).unwrap();
    assert_eq!(quotas.lock().owners[&ada.to_string()].trained_ms.len(), 1);
    quotas.spend(&ada, f64::NAN, noon + 26 * HOUR_S).unwrap();
    quotas.spend(&ada, -5.0, noon + 26 * HOUR_S).unwrap();
    assert_eq!(quotas.usage(&ada, noon + 26 * HOUR_S).training_seconds, 1);
    assert_eq!(quotas.seconds_left(&ada, &Limits::default(), noon), None);
}

#[test]
fn jobs_have_a_limit() {
    assert_eq!(check_jobs(&LIMITS, 1), Ok(()));
    let over = check_jobs(&LIMITS, 2).unwrap_err();
    assert_eq!((over.kind, over.used, over.frees), (Kind::QueuedJobs, 2, Frees::OnEnd));
    assert_eq!(check_jobs(&Limits::default(), u64::MAX), Ok(()));
}

#[test]
fn an_import_that_comes_to_nothing_is_not_charged_and_one_that_was_cut_off_is_found() {
    let place = Place::new();
    let quotas = place.open();
    let ada = owner("ada");
    let import = Reserved::new(&quotas, ada, &LIMITS, "import 1".into(), charge(90, 9)).unwrap();
    // Two imports at the same time cannot both have the last of it.
    assert!(Reserved::new(&quotas, ada, &LIMITS, "import 2".into(), charge(90, 9)).is_err());
    drop(import);
    assert_eq!(place.open().usage(&ada, 0), Usage::default());

    let import = Reserved::new(&quotas, ada, &LIMITS, "import 3".into(), charge(50, 5)).unwrap();
    import.became("town").unwrap();
    let kept = Usage { bytes: 50, views: 5, ..Usage::default() };
    assert_eq!(place.open().usage(&ada, 0), kept);

    // The process dies during an import, and after a deletion that was not yet written down here.
    quotas.spend(&ada, 1.0, 0).unwrap();
    std::mem::forget(Reserved::new(&quotas, ada, &LIMITS, "import 4".into(), charge(40, 4)).unwrap());
    let quotas = place.open();
    assert_eq!(quotas.usage(&ada, 0).bytes, 90);
    quotas.reconcile([(ada, "town".to_owned(), charge(50, 5))]).unwrap();
    let usage = Usage { training_seconds: 1, training_frees_at: 24 * HOUR_S, ..kept };
    assert_eq!(place.open().usage(&ada, 0), usage, "what was trained stays");
    quotas.reconcile([]).unwrap();
    assert_eq!(place.open().usage(&ada, 0).bytes, 0);
}

#[test]
fn what_cannot_be_written_does_not_count() {
    let place = Place::new();
    let quotas = place.open();
    let ada = owner("ada");
    quotas.charge(&ada, &LIMITS, "town", charge(10, 1)).unwrap();
    let path = place.0.path().join("usage.json");
    let aside = place.0.path().join("aside");
    std::fs::rename(&path, &aside).unwrap();
    // A folder in the file's place: no write succeeds, whoever runs the test.
    std::fs::create_dir_all(path.join("in the way")).unwrap();
    assert!(matches!(quotas.charge(&ada, &LIMITS, "well", charge(10, 1)), Err(AccessError::File(_))));
    assert!(quotas.release(&ada, "town").is_err());
    assert_eq!(quotas.usage(&ada, 0).bytes, 10);
    std::fs::remove_dir_all(&path).unwrap();
    std::fs::rename(&aside, &path).unwrap();
    // Half a file left by a process that died while writing is in nobody's way.
    std::fs::write(place.0.path().join("usage.json.new"), b"{\"format_ver").unwrap();
    quotas.charge(&ada, &LIMITS, "well", charge(10, 1)).unwrap();
    assert_eq!(place.open().usage(&ada, 0).bytes, 20);
}

#[test]
fn records_have_limits_by_the_day_and_in_all() {
    let place = Place::new();
    let quotas = place.open();
    let (ada, day) = (owner("ada"), 24 * HOUR_S);
    let start = 1000 * HOUR_S;
    let charge = |now| place.open().charge_record(&ada, &LIMITS, now);
    for hour in 0..3 {
        charge(start + hour * HOUR_S).unwrap();
    }
    let full = refused(charge(start + 3 * HOUR_S));
    assert_eq!((full.kind, full.used, full.frees), (Kind::RecordsPerDay, 3, Frees::At(start + day)));
    let said = full.to_string();
    assert!(
        said.starts_with("the owner's quota `records_per_day` is 3: 3 used, 1 more asked for; it frees at"),
        "{said}"
    );
    assert_eq!(refused(charge(start + day - 1)).kind, Kind::RecordsPerDay);
    // A day later there is room for one, and what did not get into the log is given back.
    charge(start + day).unwrap();
    place.open().forgive_record(&ada, &LIMITS, start + day).unwrap();
    charge(start + day).unwrap();
    let used = place.open().usage(&ada, start + day);
    assert_eq!((used.records, used.records_per_day), (4, 3));
    charge(start + day + HOUR_S).unwrap();
    // In all, whatever the day.
    let full = refused(charge(start + 9 * day));
    assert_eq!((full.kind, full.limit, full.used, full.frees), (Kind::Records, 5, 5, Frees::OnRaise));
    assert!(full.to_string().contains("an operator can raise it (cairn access quota)"));
    // Others have their own, and 0 is no limit.
    quotas.charge_record(&owner("bob"), &LIMITS, start).unwrap();
    place.open().charge_record(&ada, &Limits::default(), start + 9 * day).unwrap();
}
