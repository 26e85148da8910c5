//! Every setting of the daemon, declared once: name, type, default, what is allowed, what it is, and why a user
//! changes it. The typed structs, the check, `configs/daemon.toml` and `docs/reference/config.md` are made from this.

use cairn_field::AppearanceMode;
use serde::{Deserialize, Serialize};

use super::declare::{Allowed, settings};
use super::training::{PresetChoice, Quality};
use crate::auth::Policy;
use crate::auth::token::MAX_LIFETIME_S;

/// The largest whole number of a TOML file.
const LARGEST: u64 = i64::MAX as u64;

/// How callers are let in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AccessMode {
    /// `token` where there is a token file, else `open`.
    Auto,
    /// Every caller.
    Open,
    /// Who brings the daemon's one token.
    Token,
    /// Who has an account.
    Accounts,
}

/// Whether reading needs a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reading {
    /// It needs none.
    Open,
    /// It needs one, of any account.
    Closed,
}

/// How log lines look.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LogFormat {
    /// For people.
    Text,
    /// For collectors: one JSON object a line.
    Json,
}

settings! {
    /// Where the daemon listens and how it ends.
    ["server"] server: Server {
        /// The IP address and port to listen at; port 0 takes a free one, which the first line of output names.
        /// Anything but loopback (127.0.0.1, ::1) needs an `access.mode` that asks who calls, and TLS.
        bind: String = "127.0.0.1:7341".into(), Allowed::Text("an IP address and a port, as 127.0.0.1:7341"),
            "Other machines are to reach the daemon, or the port is taken.";
        /// Whether to serve other addresses than loopback without TLS. Tokens and photographs then travel unencrypted.
        plaintext: bool = false, Allowed::Switch,
            "A proxy in front of the daemon ends TLS.";
        /// Seconds that running requests may still take after SIGINT or SIGTERM. A running training writes its
        /// checkpoint first, however long that takes.
        shutdown_grace_s: u64 = 10, Allowed::Whole(0, 600),
            "A service manager kills after a time of its own, or long downloads are to end.";
    }

    /// TLS by rustls. An empty certificate and key mean none.
    ["server.tls"] tls: Tls {
        /// The PEM file of the daemon's certificate, those that vouch for it after it.
        certificate: String = String::new(), Allowed::Text("the path of a PEM file, or empty"),
            "Others reach the daemon over a network.";
        /// The PEM file of the certificate's private key.
        key: String = String::new(), Allowed::Text("the path of a PEM file, or empty"),
            "It goes with the certificate.";
        /// The PEM file of the certificates that vouch for clients. Every client must then bring one (mutual TLS).
        client_ca: String = String::new(), Allowed::Text("the path of a PEM file, or empty"),
            "Only machines with a certificate of yours are to connect at all.";
    }

    /// Who may call.
    ["access"] access: Access {
        /// Who may change or spend something. `open`: every caller, on loopback only. `token`: callers with the bearer
        /// token in `token_file`. `accounts`: callers with an account, who sign every call with their key.
        /// `auto`: `token` where `token_file` is set, else `open`.
        mode: AccessMode = AccessMode::Auto, Allowed::OneOf(&["auto", "open", "token", "accounts"]),
            "More than one person uses the daemon.";
        /// Whether every caller may read (`open`), or reading needs a token too (`closed`). Health, reflection and
        /// registration never need one.
        read: Reading = Reading::Open, Allowed::OneOf(&["open", "closed"]),
            "Photographs, renders and owners are not for the public.";
        /// The file that holds one bearer token (16 to 512 printable ASCII characters). Calls bring it as
        /// `authorization: Bearer <token>`.
        token_file: String = String::new(), Allowed::Text("the path of a token's file, or empty"),
            "One secret is enough: a single team, or programs of your own.";
        /// Who gets an account. `open`: every caller, as contributor. `approval`: those that an operator approves.
        /// `closed`: no new accounts. `cairn access add` on this machine makes the first operator.
        registration: Policy = Policy::Approval, Allowed::OneOf(&["open", "approval", "closed"]),
            "Visitors are to contribute without waiting, or no new ones are.";
        /// The longest life of a signed token, seconds. Clocks may differ by 30 s.
        token_lifetime_s: u64 = MAX_LIFETIME_S, Allowed::Whole(10, MAX_LIFETIME_S),
            "A token that leaks is to be worth less time.";
    }

    /// What an account may use without quotas of its own, in mode `accounts`. 0 is no limit.
    ["access.quota"] quota: Quota {
        /// Bytes of photographs stored.
        bytes: u64 = 16 << 30, Allowed::Whole(0, LARGEST),
            "The disk is smaller or larger, or there are many contributors.";
        /// Views stored.
        views: u64 = 10_000, Allowed::Whole(0, LARGEST),
            "One contributor is not to crowd out the others.";
        /// Seconds of training within a rolling day.
        training_seconds: u64 = 28_800, Allowed::Whole(0, LARGEST),
            "Accounts share one machine's time.";
        /// Trainings accepted or running at the same time.
        queued_jobs: u64 = 4, Allowed::Whole(0, LARGEST),
            "One account is not to fill the queue.";
        /// Owner records submitted, in all. The log keeps them, so they never free up again; revocations do not count.
        /// With this or the next limit, each record of an account costs one more small file flushed to the disk.
        records: u64 = 0, Allowed::Whole(0, LARGEST),
            "The public log is to stay small, however many write to it.";
        /// Owner records submitted within a rolling day.
        records_per_day: u64 = 10_000, Allowed::Whole(0, LARGEST),
            "A stolen key is not to flood the log.";
    }

    /// What the daemon accepts at most.
    ["limits"] limits: Limits {
        /// The largest gRPC message taken or sent, bytes.
        max_message_bytes: usize = 32 << 20, Allowed::Whole(1 << 16, 1 << 30),
            "A training's signals or a large render do not fit, or memory is short.";
        /// Renders, detections and evaluations computed at the same time; more wait.
        concurrent_renders: usize = 2, Allowed::Whole(1, 256),
            "The machine has more cores and memory, or fewer.";
        /// Trainings accepted and not yet begun; one more is refused.
        queue_length: usize = 16, Allowed::Whole(1, 10_000),
            "Work is to be queued for days, or refused at once.";
        /// The largest photograph, bytes of its file.
        max_photograph_bytes: u64 = 64 << 20, Allowed::Whole(1024, 1 << 30),
            "Cameras write larger files, or uploads are not trusted.";
        /// The longest side of a photograph or a render, px.
        max_side_px: usize = 16_384, Allowed::Whole(16, 65_536),
            "Panoramas are longer.";
        /// The most pixels in a photograph or a render. A pixel takes some 12 bytes of memory while it is computed.
        max_pixels: u64 = 100_000_000, Allowed::Whole(256, 1_000_000_000),
            "Memory is short, or cameras have more pixels.";
        /// The most frames of a camera path.
        max_path_frames: usize = 2_000, Allowed::Whole(2, 100_000),
            "A film is longer, or one caller is not to render for hours.";
        /// The most views in a scene.
        max_views: usize = 10_000, Allowed::Whole(2, 1_000_000),
            "A landmark has more photographs, or memory is short.";
        /// The largest scene, bytes of all its photographs.
        max_scene_bytes: u64 = 16 << 30, Allowed::Whole(1024, 1 << 40),
            "The disk is smaller or larger.";
    }

    /// Training. A request's own option counts first, then this file's, then the preset's.
    ["training"] training: Training {
        /// The preset: `forward` (all cameras look the same way), `object` (within a box, from all around) or `outdoor`
        /// (a landmark in the open); `auto` takes the one of the scene's kind. `configs/` has a file of each.
        preset: PresetChoice = PresetChoice::Auto, Allowed::OneOf(&["auto", "forward", "object", "outdoor"]),
            "Importing took the scene for another kind than it is.";
        /// How long training takes and how good it is: `draft` (minutes), `balanced`, `archival` (twice the work, not
        /// measured yet), or `smoke` (seconds: for a program's own integration tests and for trying an installation,
        /// good for nothing else).
        quality: Quality = Quality::Balanced, Allowed::OneOf(&["smoke", "draft", "balanced", "archival"]),
            "Time matters more than the picture, or less.";
        /// Whether marks outlast what happens to pictures (JPEG, blur, noise, other light, rotation, smaller copies), at
        /// a price in the picture.
        robust: bool = false, Allowed::Switch,
            "Pictures will travel through messengers and social networks.";
        /// Seconds of training between checkpoints; 0 writes one after every step.
        checkpoint_every_s: u64 = 30, Allowed::Whole(0, 86_400),
            "The disk is slow, or the machine loses power often.";
        /// The most vertices of the field's grid. Training takes some 24 bytes for each, a daemon that
        /// serves it 8, and questions about contributors 3 more for each photograph that shows it.
        max_voxels: usize = 0, Allowed::WholeOrPreset(4096, 500_000_000),
            "Memory is short.";
        /// Whether every view gets an appearance of its own: `on`, `off`, or `auto`, where the photographs turn out to
        /// differ in light.
        appearance: AppearanceMode = AppearanceMode::Auto, Allowed::OneOf(&["auto", "on", "off"]),
            "You know whether the photographs share one light; `auto` sometimes errs.";
        /// The side of hidden pictures, px (128 in the presets).
        payload_picture_px: usize = 0, Allowed::MultipleOrPreset(16, 32, 512),
            "An emblem needs more detail, or less.";
        /// The longest hidden sound, seconds (4 in the presets).
        payload_sound_s: f64 = 0.0, Allowed::NumberOrPreset(0.1, 30.0),
            "A spoken name or a jingle is longer.";
        /// Samples a second of hidden sounds (16000 in the presets); others are resampled.
        payload_sound_hz: u32 = 0, Allowed::WholeOrPreset(4000, 48_000),
            "Speech needs less than music, and less is easier to hide.";
        /// The longest hidden text, bytes of UTF-8 (256 in the presets).
        payload_text_bytes: usize = 0, Allowed::WholeOrPreset(1, 4096),
            "A licence or an address is longer.";
    }

    /// The log of owner records.
    ["registry"] registry: Registry {
        /// The log's name, its origin line. It goes into every checkpoint and record, so it cannot change once a record
        /// is in.
        origin: String = "cairn.localhost/owners".into(), Allowed::Text("1 to 256 bytes without spaces or plus signs"),
            "Others read the log: its name has to be yours alone.";
        /// The file (made by `cairn keys new-key-file`) that seals registry.key, the key that signs the log. Keep it on
        /// another disk than the data folder, or in the service manager's credentials. Empty: registry.key is plain
        /// PEM, readable by its owner alone. `cairn keys seal DATA/registry.key --key-file FILE` seals a plain one.
        key_file: String = String::new(), Allowed::Text("the path of a key file, or empty"),
            "Backups of the data folder are not to give the signing key away.";
        /// The log's anchor: a file outside the data folder, best on another disk. It holds the size and root signed
        /// last, so that a data folder restored from an older backup does not start. An absolute path in a folder that
        /// exists. Empty: DIR.KEY.anchor beside the data folder DIR, where KEY is the start of the log's key id. Where
        /// the log is not empty and its anchor is missing, a start needs `cairn registry anchor --accept`.
        anchor_file: String = String::new(), Allowed::Text("an absolute path outside the data folder, or empty"),
            "Whole disks are restored from backups.";
        /// Where the log's public files (checkpoint and tiles, C2SP tlog-tiles) are served over plain HTTP: any IP
        /// address, and a port, 0 for a free one. Read-only and public. Empty: not served.
        http_bind: String = String::new(), Allowed::Text("an IP address and a port, or empty"),
            "Auditors and witnesses are to read the log.";
        /// What precedes their paths, as /log. Empty: nothing.
        http_prefix: String = String::new(), Allowed::Text("a slash and segments, as /log, or empty"),
            "A proxy shares one name among several services.";
        /// Witnesses that cosign every checkpoint, each as "VKEY URL": `cairn witness vkey` shows the first, the second
        /// is its submission prefix. At most 32, no two with one key.
        witnesses: Vec<String> = Vec::new(), Allowed::Texts("a list of 0 to 32 texts \"VKEY URL\""),
            "Others are to vouch that all readers see the same log.";
    }

    /// What the daemon says of itself, on standard error.
    ["log"] log: Log {
        /// What to log, as tracing's EnvFilter reads it: error, warn, info, debug, trace, or per module
        /// (cairn=debug,info).
        filter: String = "info".into(), Allowed::Text("a tracing filter"),
            "Something is wrong, or logs are too long.";
        /// `text` for people, `json` for collectors.
        format: LogFormat = LogFormat::Text, Allowed::OneOf(&["text", "json"]),
            "A collector reads the log.";
    }
}

impl Limits {
    /// Those of a picture.
    pub fn of_pictures(&self) -> cairn_scene::Limits {
        cairn_scene::Limits {
            max_file_bytes: self.max_photograph_bytes,
            max_side_px: self.max_side_px,
            max_pixels: self.max_pixels,
            max_views: self.max_views,
        }
    }
}
