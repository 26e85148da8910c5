//! A small HTTP/1.1 server around a router, bounded in every direction.
//!
//! So many connections at a time and no more (later ones wait in the system's queue); a connection whose request
//! head does not come in time is closed; none lives longer than [`Limits::connection`] and a grace, so that neither an idle nor
//! a slow client keeps a place for good. A stop lets requests under way end within the grace. TLS is for a proxy in front.

use std::{future::Future, io, pin::pin, sync::Arc, time::Duration};

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use tokio::{
    net::{TcpListener, TcpStream},
    sync::{Semaphore, watch},
    task::JoinSet,
    time::{sleep, timeout},
};

/// Largest request head, bytes.
const MAX_HEAD_BYTES: usize = 16 << 10;
/// Wait after a failed accept (out of file handles, mostly).
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// What a server bears.
#[derive(Debug, Clone)]
pub struct Limits {
    /// Connections at the same time.
    pub connections: usize,
    /// Time for a request's head to come, also the longest idle time.
    pub head: Duration,
    /// Age at which a connection takes no new request.
    pub connection: Duration,
    /// Time for a request under way after that, and after the stop.
    pub grace: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            connections: 256,
            head: Duration::from_secs(10),
            connection: Duration::from_secs(60),
            grace: Duration::from_secs(10),
        }
    }
}

/// Serves until `stop` is done, and then what is under way.
///
/// # Errors
/// None so far: a failed accept is logged and tried again.
pub async fn serve(
    listener: TcpListener,
    router: Router,
    limits: Limits,
    stop: impl Future<Output = ()>,
) -> io::Result<()> {
    let places = Arc::new(Semaphore::new(limits.connections));
    let (ending, ended) = watch::channel(false);
    let mut connections = JoinSet::new();
    let mut stop = pin!(stop);
    loop {
        let accepted = async {
            // Never closed.
            let place = places.clone().acquire_owned().await.ok();
            listener.accept().await.map(|(stream, _)| (place, stream))
        };
        let (place, stream) = tokio::select! {
            () = &mut stop => break,
            accepted = accepted => match accepted {
                Ok(accepted) => accepted,
                Err(e) => {
                    tracing::warn!(error = %e, "cannot accept a connection");
                    sleep(ACCEPT_PAUSE).await;
                    continue;
                }
            },
        };
        while connections.try_join_next().is_some() {}
        let (router, limits, ended) = (router.clone(), limits.clone(), ended.clone());
        connections.spawn(async move {
            let _place = place;
            hold(stream, router, &limits, ended).await;
        });
    }
    drop(listener);
    // An error means that no connection is left to hear it.
    let _ = ending.send(true);
    while connections.join_next().await.is_some() {}
    Ok(())
}

/// One connection, from the first request to the last.
async fn hold(stream: TcpStream, router: Router, limits: &Limits, mut ended: watch::Receiver<bool>) {
    let mut builder = http1::Builder::new();
    builder.timer(TokioTimer::new()).header_read_timeout(limits.head).max_buf_size(MAX_HEAD_BYTES);
    let service = TowerToHyperService::new(router);
    let mut connection = pin!(builder.serve_connection(TokioIo::new(stream), service));
    tokio::select! {
        // What a client does wrong is its own affair.
        _ = connection.as_mut() => return,
        _ = ended.wait_for(|ended| *ended) => {}
        () = sleep(limits.connection) => {}
    }
    connection.as_mut().graceful_shutdown();
    let _ = timeout(limits.grace, connection).await;
}
