//! A witness on HTTP (C2SP tlog-witness, "HTTP Interface"): `POST /add-checkpoint` for logs and
//! `GET /<SHA-256 of the origin, hex>/checkpoint` for monitors, both under one prefix.

use std::{future::Future, io, sync::Arc, time::Duration};

use axum::{
    Router,
    body::{Body, HttpBody as _, to_bytes},
    extract::{Path, State},
    http::{StatusCode, header},
    response::{IntoResponse, Response},
    routing::{get, post},
};
use tokio::{net::TcpListener, time::timeout};

use crate::witness::{
    cosigner::{self, Witness},
    plain_http::{self, Limits},
    request::MAX_BODY_BYTES,
};

/// Time for a request's body to come.
const BODY_TIME: Duration = Duration::from_secs(10);

/// The routes of a witness, to be put under any prefix.
pub fn router(witness: Arc<Witness>) -> Router {
    Router::new()
        .route("/add-checkpoint", post(add_checkpoint))
        .route("/{origin}/checkpoint", get(checkpoint))
        .with_state(witness)
}

/// Serves a witness until `stop` is done, and then what is under way.
///
/// # Errors
/// As [`plain_http::serve`].
pub async fn serve(
    listener: TcpListener,
    witness: Arc<Witness>,
    limits: Limits,
    stop: impl Future<Output = ()>,
) -> io::Result<()> {
    plain_http::serve(listener, router(witness), limits, stop).await
}

async fn add_checkpoint(State(witness): State<Arc<Witness>>, body: Body) -> Response {
    // What announces itself as too large is not even read.
    if body.size_hint().lower() > MAX_BODY_BYTES as u64 {
        return StatusCode::PAYLOAD_TOO_LARGE.into_response();
    }
    let body = match timeout(BODY_TIME, to_bytes(body, MAX_BODY_BYTES)).await {
        Ok(Ok(body)) => body,
        // Too large without saying so, or torn off, when nobody reads the answer.
        Ok(Err(_)) => return StatusCode::PAYLOAD_TOO_LARGE.into_response(),
        Err(_) => return StatusCode::REQUEST_TIMEOUT.into_response(),
    };
    // It waits for the disk.
    match tokio::task::spawn_blocking(move || witness.add_checkpoint(&body)).await {
        Ok(answer) => answer.into_response(),
        Err(e) => {
            tracing::error!(error = %e, "a request's thread ended early");
            StatusCode::INTERNAL_SERVER_ERROR.into_response()
        }
    }
}

async fn checkpoint(State(witness): State<Arc<Witness>>, Path(origin): Path<String>) -> Response {
    let Ok(origin) = origin.parse() else {
        return (StatusCode::NOT_FOUND, "expected the SHA-256 of a log's origin, 64 lowercase hexadecimal digits\n")
            .into_response();
    };
    // The lock that this waits for is held while the disk is written.
    match tokio::task::spawn_blocking(move || witness.latest(&origin)).await {
        Ok(Some(note)) => {
            let headers = [(header::CONTENT_TYPE, "text/plain; charset=utf-8"), (header::CACHE_CONTROL, "no-cache")];
            (headers, note).into_response()
        }
        Ok(None) => (StatusCode::NOT_FOUND, "no checkpoint of this log was cosigned here\n").into_response(),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}

impl IntoResponse for cosigner::Response {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        (status, [(header::CONTENT_TYPE, self.content_type)], self.body).into_response()
    }
}
