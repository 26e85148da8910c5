//! The queue with a job that counts, so that every order of events can be forced.

use std::sync::mpsc;

use cairn_scene::cluster::{ClusterConfig, Grouping};

use super::*;

/// Runs as long as the test's other end of the line lets it.
struct Counting {
    tick: mpsc::Receiver<()>,
    panics: bool,
}

impl Work for Counting {
    fn run(&mut self, job: &Job, control: &Control<'_>) -> Result<Outcome, EngineError> {
        assert!(!self.panics, "as the test wants it for {}", job.id);
        for step in 1.. {
            if control.stop_requested() {
                control.spent("counting", 1.0)?;
                return Ok(Outcome::Stopped);
            }
            match self.tick.recv_timeout(std::time::Duration::from_millis(2)) {
                Ok(()) => return Ok(Outcome::Finished),
                Err(mpsc::RecvTimeoutError::Timeout) => {
                    control.progress(Progress { step, stage: "counting".into(), ..Progress::default() });
                }
                Err(mpsc::RecvTimeoutError::Disconnected) => {
                    return Err(EngineError::Internal("the line broke".into()));
                }
            }
        }
        unreachable!("the loop has no end")
    }
}

fn counting() -> (mpsc::Sender<()>, Counting) {
    let (sender, tick) = mpsc::channel();
    (sender, Counting { tick, panics: false })
}

fn spec() -> JobSpec {
    JobSpec {
        also: Vec::new(),
        marks: Vec::new(),
        grow_from: Vec::new(),
        scene: "s".into(),
        grouping: Grouping::Anchors(ClusterConfig::default()),
        seed: u64::MAX,
        settings: crate::config::TrainingSettings::given(Default::default(), Default::default()),
        signals: Vec::new(),
        base_only: true,
    }
}

fn wait_for(jobs: &Jobs, id: &str, wanted: impl Fn(&Job) -> bool) -> Job {
    let mut watch = jobs.watch(id).unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
    runtime.block_on(async { watch.wait_for(|job| wanted(job)).await.unwrap().clone() })
}

fn submit(jobs: &Jobs) -> String {
    jobs.submit(None, spec(), Vec::new(), |_| Ok(())).unwrap().id
}

#[test]
fn jobs_run_in_turn_and_the_queue_has_an_end() {
    let dir = tempfile::tempdir().unwrap();
    let (tick, work) = counting();
    let jobs = Jobs::open(dir.path().into(), 1, None, true, work).unwrap();
    let first = submit(&jobs);
    wait_for(&jobs, &first, |j| j.state == JobState::Running);
    let second = submit(&jobs);
    assert!(matches!(jobs.submit(None, spec(), Vec::new(), |_| Ok(())), Err(EngineError::QueueFull { limit: 1 })));
    tick.send(()).unwrap();
    wait_for(&jobs, &first, |j| j.state == JobState::Done);
    wait_for(&jobs, &second, |j| j.state == JobState::Running);
    tick.send(()).unwrap();
    wait_for(&jobs, &second, |j| j.state == JobState::Done);
    assert_eq!(jobs.list().iter().map(|j| j.id.as_str()).collect::<Vec<_>>(), ["job-000002", "job-000001"]);
}

#[test]
fn a_cancelled_job_lets_go_and_can_be_resumed() {
    let dir = tempfile::tempdir().unwrap();
    let (tick, work) = counting();
    let jobs = Jobs::open(dir.path().into(), 4, None, true, work).unwrap();
    let (running, waiting) = (submit(&jobs), submit(&jobs));
    wait_for(&jobs, &running, |j| j.progress.step > 0);
    jobs.cancel(&waiting).unwrap();
    assert_eq!(jobs.get(&waiting).unwrap().state, JobState::Cancelled);
    assert!(matches!(jobs.resume(&running), Err(EngineError::WrongState { .. })));
    jobs.cancel(&running).unwrap();
    let job = wait_for(&jobs, &running, |j| j.state.has_ended());
    assert_eq!((job.state, job.stages.len()), (JobState::Cancelled, 1));
    jobs.resume(&running).unwrap();
    tick.send(()).unwrap();
    assert_eq!(wait_for(&jobs, &running, |j| j.state.has_ended()).state, JobState::Done);
    assert!(matches!(jobs.cancel("job-000009"), Err(EngineError::NotFound { .. })));
}

#[test]
fn what_was_cut_off_is_found_again_and_what_was_not_durable_is_not() {
    let dir = tempfile::tempdir().unwrap();
    let (_tick, work) = counting();
    let jobs = Jobs::open(dir.path().into(), 4, None, true, work).unwrap();
    let (first, second) = (submit(&jobs), submit(&jobs));
    wait_for(&jobs, &first, |j| j.progress.step > 0);
    jobs.shut_down();
    assert!(matches!(jobs.submit(None, spec(), Vec::new(), |_| Ok(())), Err(EngineError::ShuttingDown)));
    drop(jobs);
    std::fs::create_dir(dir.path().join("job-000003")).unwrap();

    let (tick, work) = counting();
    let jobs = Jobs::open(dir.path().into(), 4, None, true, work).unwrap();
    assert_eq!(jobs.list().len(), 2);
    assert_eq!(jobs.get(&first).unwrap().spec, spec());
    for id in [&first, &second] {
        tick.send(()).unwrap();
        assert_eq!(wait_for(&jobs, id, |j| j.state.has_ended()).state, JobState::Done);
    }
}

#[test]
fn what_was_cut_off_waits_for_a_person_where_nobody_serves() {
    let dir = tempfile::tempdir().unwrap();
    let (_tick, work) = counting();
    let jobs = Jobs::open(dir.path().into(), 4, None, true, work).unwrap();
    let (first, second) = (submit(&jobs), submit(&jobs));
    wait_for(&jobs, &first, |j| j.progress.step > 0);
    jobs.shut_down();
    drop(jobs);

    let (tick, work) = counting();
    let jobs = Jobs::open(dir.path().into(), 4, None, false, work).unwrap();
    for id in [&first, &second] {
        assert_eq!(jobs.get(id).unwrap().state, JobState::Interrupted);
    }
    jobs.cancel(&second).unwrap();
    assert_eq!(jobs.get(&second).unwrap().state, JobState::Cancelled);
    // What is looked at stays as it is: the next one who opens it finds the same.
    drop(jobs);
    let (tick_again, work) = counting();
    drop(tick);
    let jobs = Jobs::open(dir.path().into(), 4, None, false, work).unwrap();
    assert_eq!(jobs.get(&first).unwrap().state, JobState::Interrupted);
    assert_eq!(jobs.get(&second).unwrap().state, JobState::Cancelled);
    jobs.resume(&first).unwrap();
    tick_again.send(()).unwrap();
    assert_eq!(wait_for(&jobs, &first, |j| j.state.has_ended()).state, JobState::Done);
}

#[test]
fn a_panic_fails_its_job_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    let (_tick, mut work) = counting();
    work.panics = true;
    let jobs = Jobs::open(dir.path().into(), 4, None, true, work).unwrap();
    let (first, second) = (submit(&jobs), submit(&jobs));
    for id in [&first, &second] {
        let job = wait_for(&jobs, id, |j| j.state.has_ended());
        assert_eq!(job.state, JobState::Failed);
        assert!(job.error.contains("as the test wants it"), "{}", job.error);
    }
}

#[test]
fn a_job_that_cannot_be_prepared_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let (_tick, work) = counting();
    let jobs = Jobs::open(dir.path().into(), 4, None, true, work).unwrap();
    let refused = jobs.submit(None, spec(), Vec::new(), |_| Err(EngineError::ShuttingDown));
    assert!(refused.is_err());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}
