//! A step that fails: what is left of the training, and that it is taken up from there.

use cairn_scene::cluster::Grouping;
use std::path::Path;

use super::*;
use crate::train::job::JobSpec;

/// Counts to nine; its checkpoint is the count.
struct Counting {
    count: u64,
    /// How often it was asked for a step.
    asked: u64,
    /// The count at which a step fails, and whether that step counts all the same.
    fails: Option<(u64, bool)>,
}

impl stages::Stage for Counting {
    fn step(&mut self) -> Result<stages::Step, EngineError> {
        self.asked += 1;
        if let Some((_, counts)) = self.fails.filter(|(at, _)| *at == self.count) {
            self.count += u64::from(counts);
            return Err(EngineError::Internal("a number that is not finite".into()));
        }
        self.count += 1;
        Ok(stages::Step { loss: 0.0, psnr_db: 0.0 })
    }

    fn steps(&self) -> (u64, u64) {
        (self.count, 9)
    }

    fn checkpoint(&self) -> Result<Vec<u8>, EngineError> {
        Ok(self.count.to_le_bytes().to_vec())
    }
}

#[test]
fn a_step_that_fails_leaves_the_last_good_state_and_its_own_error() {
    let dir = TestFolder::new();
    let (stop, sender) = (Arc::new(AtomicU8::new(0)), watch::Sender::new(Job::accepted("job".into(), spec(), 0)));
    let control = Control::going_on(&stop, &sender, dir.path().join("job.json"));
    let training = Training {
        scenes: dir.path().into(),
        models: dir.path().into(),
        jobs: dir.path().into(),
        exclusions: Arc::new(Exclusions::open(dir.path().join("exclusions"), dir.path()).unwrap()),
        // No checkpoint falls due in between.
        checkpoint_every: Duration::from_secs(3600),
    };
    let driven = |count: u64, fails, file: &Path| {
        let mut stage = Counting { count, asked: 0, fails };
        (drive(&training.stage("counting", Instant::now()), &mut stage, file, &control), stage.asked)
    };
    let file = dir.path().join("counting.checkpoint");
    let kept = || read_checkpoint(&file).unwrap().map(|bytes| u64::from_le_bytes(bytes.try_into().unwrap()));
    let says = |result: Result<bool, EngineError>| {
        let error = result.expect_err("the step failed").to_string();
        assert!(error.contains("a number that is not finite"), "{error}");
    };
    let (result, asked) = driven(0, Some((5, false)), &file);
    says(result);
    assert_eq!((asked, kept()), (6, Some(5)));
    assert_eq!(sender.borrow().stages.len(), 1, "its seconds count");
    // Taken up, it goes on from there.
    let (result, asked) = driven(kept().unwrap(), None, &file);
    assert_eq!((result.unwrap(), asked, kept()), (true, 4, Some(9)));
    // What failed after a step that counts has to be come to again: the checkpoint stays.
    write_atomic(&file, &2u64.to_le_bytes()).unwrap();
    let (result, _) = driven(2, Some((6, true)), &file);
    says(result);
    assert_eq!(kept(), Some(2));
    // Where the state cannot be written either, the step's error is told.
    let nowhere = dir.path().join("nowhere").join("counting.checkpoint");
    says(driven(0, Some((5, false)), &nowhere).0);
    assert!(!nowhere.exists());
}

/// What a job that nobody runs was asked for.
fn spec() -> JobSpec {
    JobSpec {
        scene: "town".into(),
        also: Vec::new(),
        marks: Vec::new(),
        grow_from: Vec::new(),
        grouping: Grouping::Anchors(cairn_scene::cluster::ClusterConfig::default()),
        seed: 7,
        settings: tiny(),
        signals: Vec::new(),
        base_only: true,
    }
}

#[test]
fn a_job_whose_numbers_go_wrong_is_resumed_at_the_step_that_failed() {
    let dir = TestFolder::new();
    let engine = open(dir.path());
    import(dir.path(), "town", 3);
    // Densities beyond what smoothing can square, when it is first due after the first step.
    let mut wild = tiny();
    wild.field.learning_rate_density = 1e30;
    let wanted = TrainingRequest { base_only: true, plan: given(wild), ..request(2) };
    let job = ended(&engine, &engine.train(wanted).unwrap().id);
    assert_eq!(job.state, JobState::Failed);
    assert!(job.error.contains("not finite") && job.error.contains("learning_rate_density"), "{}", job.error);
    let file = dir.path().join("jobs").join(&job.id).join("base.checkpoint");
    let checkpoint = read_checkpoint(&file).unwrap().expect("the state before the step that failed");
    let scene = scenes::open(&dir.path().join("scenes"), "town").unwrap();
    let (settings, seed) = (&job.spec.settings, job.spec.seed);
    let made =
        stages::base_trainer(&scene, &Default::default(), settings, seed, Some(&checkpoint), &mut |_, _, _| true);
    let mut trainer = made.unwrap().unwrap();
    let (done, all) = (trainer.steps_done(), trainer.steps_total());
    assert!((1..all).contains(&done) && job.error.contains(&format!("step {done}:")), "{done}: {}", job.error);
    assert_eq!(trainer.step().unwrap_err().to_string(), job.error, "the next step is the one that failed");
    // The daemon takes it up there as well, and it ends as it did.
    engine.jobs().resume(&job.id).unwrap();
    let again = ended(&engine, &job.id);
    assert_eq!((again.state, &again.error), (JobState::Failed, &job.error));
    assert_eq!(std::fs::read(&file).unwrap(), checkpoint);
}
