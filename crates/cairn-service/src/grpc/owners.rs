//! `OwnerService`.

use std::time::{Duration, Instant};

use cairn_api::v1::{self, owner_service_server::OwnerService};
use cairn_log::{LogEntry, RecordKind, Registry, RegistryError, SignedRecord};
use tonic::{Request, Response, Status};

use super::gate::About;
use super::{Answer, Shared, from_proto, to_proto};
use crate::auth::Need;
use crate::engine::Engine;
use crate::error::EngineError;
use crate::records::{bindings, corrections, owners as records};

/// Most records in one answer.
const MAX_LISTED: u32 = 1000;

/// How long a writer of the log is waited for.
#[derive(Clone, Copy, Debug)]
struct Patience {
    /// Longest that a round of records may be written for; far more than a slow disk takes.
    longest: Duration,
    /// How often that is looked at.
    look: Duration,
}

const PATIENCE: Patience = Patience { longest: Duration::from_secs(60), look: Duration::from_secs(5) };

#[tonic::async_trait]
impl OwnerService for Shared {
    async fn nonce(&self, request: Request<v1::NonceRequest>) -> Answer<v1::NonceResponse> {
        let owner = from_proto::public_key("owner_key", &request.get_ref().owner_key)?;
        self.authorise(request.extensions(), About::Place(&request.get_ref().scene))?;
        let (scene, owner) = (request.into_inner().scene, owner.to_bytes());
        self.run(move |engine| {
            Ok(v1::NonceResponse {
                nonce: engine.nonce(&scene, &owner)?,
                origin: engine.registry().origin().to_owned(),
                checkpoint: engine.registry().checkpoint(),
                good_for_records: cairn_log::log::NONCE_LIFETIME,
            })
        })
        .await
        .map(Response::new)
    }

    async fn material(&self, request: Request<v1::MaterialRequest>) -> Answer<v1::MaterialResponse> {
        self.authorise(request.extensions(), About::Scene(&request.get_ref().scene))?;
        let v1::MaterialRequest { scene, of, .. } = request.into_inner();
        let about = from_proto::signed_about(of)?;
        let found = self.run(move |engine| engine.material(&scene, &about)).await?;
        let model = found.info.as_ref().map(to_proto::model).unwrap_or_default();
        let text = String::from_utf8(found.signal.text.unwrap_or_default())
            .map_err(|e| Status::data_loss(format!("the hidden text is no UTF-8: {e}")))?;
        Ok(Response::new(v1::MaterialResponse {
            label: found.label,
            marked_field_sha256: model.marked_field_sha256,
            detector_sha256: model.detector_sha256,
            settings_sha256: model.settings_sha256,
            seed: model.seed,
            signal: found.signal.picture.unwrap_or_default().into(),
            audio: found.signal.audio.unwrap_or_default().into(),
            text,
            photograph_sha256: found.photographs.iter().map(|d| d.as_bytes().to_vec().into()).collect(),
            base_field_sha256: model.base_field_sha256,
            share_table_sha256: model.share_table_sha256,
        }))
    }

    async fn submit(&self, request: Request<v1::SubmitRecordRequest>) -> Answer<v1::SubmitRecordResponse> {
        // Read once, here; whether the log takes it is the registry's to say.
        let signed = SignedRecord::parse(&request.get_ref().envelope).map_err(RegistryError::from);
        let signed = signed.map_err(EngineError::from)?;
        let (scene, envelope) = (&signed.record().scene, signed.envelope());
        let payer = match signed.record().kind {
            // What a name stands for is a curator's to say, under a key of their own.
            RecordKind::Binding => {
                self.authorise_as(request.extensions(), Need::Curate, About::Own(scene, envelope))?
            }
            _ => self.authorise(request.extensions(), About::Signed(scene, envelope))?,
        };
        while_the_disk_answers(self, move |engine| {
            let receipt = engine.submit_record(&signed, payer)?;
            let tlog_proof = receipt.tlog_proof().to_text();
            Ok(v1::SubmitRecordResponse {
                record: Some(to_proto::record(receipt.index, &receipt.leaf_hash, &receipt.envelope, signed.record())),
                checkpoint: receipt.checkpoint,
                tlog_proof,
                vkey: engine.registry().verifier()?.to_string(),
            })
        })
        .await
        .map(Response::new)
    }

    async fn list(&self, request: Request<v1::ListRecordsRequest>) -> Answer<v1::ListRecordsResponse> {
        let v1::ListRecordsRequest { scene, from, limit } = request.into_inner();
        let limit = if limit == 0 { MAX_LISTED } else { limit.min(MAX_LISTED) } as usize;
        let most = self.most_bytes / 2;
        let (records, next) = self
            .run(move |engine| {
                let (of, registry) = ((!scene.is_empty()).then_some(scene.as_str()), engine.registry());
                let convert = |entry: &LogEntry| with_standing(registry, entry, &scene);
                records::page(registry, of, from, limit, most, convert, bytes_of)
            })
            .await?;
        Ok(Response::new(v1::ListRecordsResponse { records, next }))
    }

    async fn get(&self, request: Request<v1::GetRecordRequest>) -> Answer<v1::GetRecordResponse> {
        let v1::GetRecordRequest { index } = request.into_inner();
        self.run(move |engine| {
            let record = with_standing(engine.registry(), &engine.registry().entry(index)?, "")?;
            let record = record.ok_or(RegistryError::NotARecord { index })?;
            Ok(v1::GetRecordResponse { record: Some(record) })
        })
        .await
        .map(Response::new)
    }

    async fn answer(&self, request: Request<v1::AnswerRequest>) -> Answer<v1::AnswerResponse> {
        let v1::AnswerRequest { scene, of, as_of, .. } = request.into_inner();
        let view = from_proto::asked_view(of)?;
        let most = self.most_bytes;
        let answer = self
            .compute(move |engine| {
                engine.complete_answer(&scene, view, (!as_of.is_empty()).then_some(as_of.as_str()), most)
            })
            .await?;
        let without_shares = answer.without_shares.unwrap_or_default();
        Ok(Response::new(v1::AnswerResponse { answer: answer.json.into(), without_shares }))
    }

    async fn checkpoint(&self, _: Request<v1::CheckpointRequest>) -> Answer<v1::CheckpointResponse> {
        let (vkey, checkpoint) =
            self.run(|engine| Ok((engine.registry().verifier()?.to_string(), engine.registry().checkpoint()))).await?;
        Ok(Response::new(v1::CheckpointResponse { checkpoint, vkey }))
    }

    async fn proof(&self, request: Request<v1::ProofRequest>) -> Answer<v1::ProofResponse> {
        let v1::ProofRequest { index } = request.into_inner();
        let proof = self.run(move |engine| Ok((engine.tlog_proof(index)?, engine.witnesses()))).await?;
        let (tlog_proof, witnesses) = proof;
        Ok(Response::new(v1::ProofResponse { tlog_proof, witnesses: witnesses as u32 }))
    }

    async fn erase(&self, request: Request<v1::EraseRecordRequest>) -> Answer<v1::EraseRecordResponse> {
        let asked = request.get_ref().request.clone();
        let asked = self.run(move |engine| corrections::erasure_asked(engine.registry(), &asked)).await?;
        self.authorise(request.extensions(), About::Signed(&asked.stored.record.scene, &asked.envelope))?;
        let index =
            while_the_disk_answers(self, move |engine| corrections::erase_record(engine.registry(), &asked)).await?;
        Ok(Response::new(v1::EraseRecordResponse { index }))
    }
}

/// A log entry as a record with its standing, `scene` being what it was asked for under; none for a map leaf.
fn with_standing(registry: &Registry, entry: &LogEntry, scene: &str) -> Result<Option<v1::Record>, EngineError> {
    let Some(mut record) = to_proto::entry(entry, scene) else { return Ok(None) };
    if let LogEntry::Record(stored) = entry {
        let confirmed_by = bindings::confirmed_by(registry, stored)?;
        record.standing = Some(to_proto::standing(corrections::standing(registry, stored)?, confirmed_by));
    }
    Ok(Some(record))
}

/// About how many bytes a listed record is, and no fewer. Anybody's disputes make it longer: each is a varint, 10 bytes at
/// most.
fn bytes_of(record: &v1::Record) -> usize {
    let disputes = record.standing.as_ref().map_or(0, |standing| standing.disputed_by.len());
    record.envelope.len() + 10 * disputes + 1024
}

/// As [`Shared::run`], for what writes into the log: where a disk does not answer, or the store waits for itself (sled
/// does where two of its threads fail to write at once), its writer never ends. Then writing stops, and whoever
/// waits is told.
async fn while_the_disk_answers<T: Send + 'static>(
    shared: &Shared,
    what: impl FnOnce(&Engine) -> Result<T, EngineError> + Send + 'static,
) -> Result<T, Status> {
    let engine = shared.engine()?;
    let stop = |cause: &str| {
        engine.registry().stop_writing(cause);
        tracing::error!(cause, "the log stopped writing");
    };
    PATIENCE.wait(shared.run(what), || engine.registry().writing_for(), stop).await
}

impl Patience {
    /// Waits for `work`, which writes into a log whose present round has been written for `writing_for`; `stop` ends all
    /// writing, and says why.
    async fn wait<T>(
        self,
        work: impl Future<Output = Result<T, Status>>,
        writing_for: impl Fn() -> Option<Duration>,
        stop: impl FnOnce(&str),
    ) -> Result<T, Status> {
        let begun = Instant::now();
        tokio::pin!(work);
        let mut overdue = false;
        loop {
            if let Ok(answer) = tokio::time::timeout(self.look, &mut work).await {
                return answer;
            }
            let seconds = self.longest.as_secs();
            let was_overdue =
                std::mem::replace(&mut overdue, writing_for().is_some_and(|written| written >= self.longest));
            // Seen twice: a process that was halted finds every clock run on, and its round ends a moment later.
            if overdue && was_overdue {
                let cause = format!("its disk has not answered for {seconds} seconds");
                stop(&cause);
                let remedy = "see whether the disk is full or failing, kill the daemon and start it again";
                return Err(Status::unavailable(format!(
                    "the log stopped writing: {cause}; {remedy}, and ask again: what was asked for may be done"
                )));
            }
            // The log writes or rests, and what the call does beside it does not end.
            if !overdue && begun.elapsed() >= self.longest * 2 {
                return Err(Status::unavailable(format!(
                    "not done in {} seconds; see whether the daemon's disk is full or failing, or its machine busy, and ask \
                     again: what was asked for may be done",
                    2 * seconds
                )));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::{Cell, RefCell};

    use super::*;

    const SHORT: Patience = Patience { longest: Duration::from_millis(200), look: Duration::from_millis(20) };

    /// What whoever waits for `work` is told, and why the log stopped, where each round is written for `round`.
    async fn told(work: impl Future<Output = Result<u8, Status>>, round: Option<Duration>) -> (String, Option<String>) {
        let (begun, stopped) = (Instant::now(), RefCell::new(None));
        let of_round = |round: Duration| {
            let at = begun.elapsed();
            // One after the other.
            Duration::from_nanos((at.as_nanos() % round.as_nanos()) as u64)
        };
        let stop = |cause: &str| drop(stopped.replace(Some(cause.to_owned())));
        let answer = SHORT.wait(work, || round.map(of_round), stop).await;
        let said = answer.map_or_else(|status| format!("{:?}: {}", status.code(), status.message()), |n| n.to_string());
        (said, stopped.take())
    }

    #[tokio::test]
    async fn whoever_waits_for_a_disk_that_does_not_answer_is_told_and_writing_stops() {
        let (said, stopped) = told(std::future::pending(), Some(Duration::from_secs(60))).await;
        assert!(said.starts_with("Unavailable: the log stopped writing: its disk has not answered"), "{said}");
        assert!(stopped.is_some_and(|cause| cause.contains("has not answered")));
    }

    #[tokio::test]
    async fn what_ends_is_answered_and_what_hangs_beside_the_log_stops_nothing() {
        let slow = async {
            tokio::time::sleep(Duration::from_millis(100)).await;
            Ok(7)
        };
        assert_eq!(told(slow, Some(Duration::from_secs(60))).await, ("7".into(), None));
        for round in [None, Some(Duration::from_millis(90))] {
            let (said, stopped) = told(std::future::pending(), round).await;
            assert!(said.starts_with("Unavailable: not done in"), "{said}");
            assert_eq!(stopped, None, "its rounds end");
        }
    }

    #[tokio::test]
    async fn a_process_that_was_halted_for_long_goes_on() {
        // Its one look finds a round that has been written for an hour, the next one another.
        let (looks, stopped) = (Cell::new(0), Cell::new(false));
        let writing_for = || {
            looks.set(looks.get() + 1);
            Some(if looks.get() == 3 { Duration::from_secs(3600) } else { Duration::from_millis(1) })
        };
        let work = async {
            tokio::time::sleep(Duration::from_millis(150)).await;
            Ok(7)
        };
        assert_eq!(SHORT.wait(work, writing_for, |_| stopped.set(true)).await.unwrap(), 7);
        assert!(looks.get() > 3 && !stopped.get());
    }
}
