//! The log's public files over plain HTTP (C2SP tlog-tiles): what monitors, mirrors and followers read.
//!
//! `/checkpoint` and `/tile/...` in their one spelling, and nothing else: a path is parsed, and the file's name is made from
//! what was parsed, so that no request can name another file. Read-only, for anybody, on an address of its own;
//! the daemon's other services stay where they are.

use std::future::Future;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use axum::Router;
use axum::extract::State;
use axum::http::{StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use cairn_durable::read_limited_if_there;
use cairn_log::Digest;
use cairn_log::format::tile::{TILE_WIDTH, TileKind, TilePath, decode_entries};
use cairn_log::witness::plain_http::{self, Limits};
use tokio::net::TcpListener;

/// Largest checkpoint that is served, bytes: as large as a note may be.
const MAX_CHECKPOINT_BYTES: u64 = cairn_log::format::note::MAX_NOTE_BYTES as u64;
/// Largest tile of entries, bytes: 256 of the largest, each with its length.
const MAX_TILE_BYTES: u64 = TILE_WIDTH as u64 * (2 + u16::MAX as u64);

const NOTE: &str = "text/plain; charset=utf-8";
const BYTES: &str = "application/octet-stream";

struct Files {
    folder: PathBuf,
    /// Empty, or `/` and segments without a slash at the end.
    prefix: String,
}

/// Serves `folder` (DIR/registry/public) under `prefix` until `stop` is done, and then what is under way.
///
/// # Errors
/// As [`plain_http::serve`].
pub async fn serve(
    listener: TcpListener,
    folder: PathBuf,
    prefix: &str,
    stop: impl Future<Output = ()>,
) -> io::Result<()> {
    plain_http::serve(listener, router(folder, prefix), Limits::default(), stop).await
}

fn router(folder: PathBuf, prefix: &str) -> Router {
    let files = Files { folder, prefix: prefix.trim_end_matches('/').to_owned() };
    // GET alone: HEAD comes with it, other methods are answered 405.
    Router::new().fallback_service(get(answer).with_state(Arc::new(files)))
}

async fn answer(State(files): State<Arc<Files>>, uri: Uri) -> Response {
    // The path as it was sent: an encoded slash or dot is no slash or dot.
    let Some(path) = uri.path().strip_prefix(&files.prefix).and_then(|path| path.strip_prefix('/')) else {
        return StatusCode::NOT_FOUND.into_response();
    };
    let (kind, caching, wanted) = match path.parse::<TilePath>() {
        Ok(tile) => (BYTES, "public, max-age=31536000, immutable", Some(tile)),
        Err(_) if path == "checkpoint" => (NOTE, "no-cache", None),
        Err(_) => return StatusCode::NOT_FOUND.into_response(),
    };
    let read = tokio::task::spawn_blocking(move || match wanted {
        Some(tile) => tile_bytes(&files.folder, tile),
        None => read(&files.folder.join("checkpoint"), MAX_CHECKPOINT_BYTES),
    });
    match read.await.map_err(io::Error::other).and_then(|read| read) {
        Ok(Some(bytes)) => ([(header::CONTENT_TYPE, kind), (header::CACHE_CONTROL, caching)], bytes).into_response(),
        Ok(None) => StatusCode::NOT_FOUND.into_response(),
        Err(e) => {
            tracing::error!(path = uri.path(), error = %e, "cannot serve a public file");
            StatusCode::INTERNAL_SERVER_ERROR.into_response()
        }
    }
}

/// A tile as it is published. A partial one may go once the full one is there, and is then cut from it (tlog-tiles,
/// "Partial Tiles").
fn tile_bytes(folder: &Path, tile: TilePath) -> io::Result<Option<Vec<u8>>> {
    if let Some(bytes) = read(&folder.join(tile.to_string()), MAX_TILE_BYTES)? {
        return cut(&bytes, tile, tile.width).map(Some);
    }
    if tile.width == TILE_WIDTH {
        return Ok(None);
    }
    let full = TilePath { width: TILE_WIDTH, ..tile };
    let Some(bytes) = read(&folder.join(full.to_string()), MAX_TILE_BYTES)? else { return Ok(None) };
    cut(&bytes, full, tile.width).map(Some)
}

/// The first `width` hashes or entries of a file that holds `tile`, which is checked: what is immutable is not served half.
fn cut(bytes: &[u8], tile: TilePath, width: u16) -> io::Result<Vec<u8>> {
    let (held, length) = match tile.kind {
        TileKind::Hashes(_) if bytes.len().is_multiple_of(Digest::LEN) => {
            (bytes.len() / Digest::LEN, usize::from(width) * Digest::LEN)
        }
        TileKind::Hashes(_) => (0, 0),
        TileKind::Entries => {
            let entries = decode_entries(bytes).map_err(|e| io::Error::new(ErrorKind::InvalidData, e))?;
            let length = |entry: &&[u8]| 2 + entry.len();
            (entries.len(), entries.iter().take(width.into()).map(length).sum())
        }
    };
    match bytes.get(..length) {
        Some(part) if held == usize::from(tile.width) => Ok(part.to_vec()),
        _ => {
            let what = format!("{tile}: {} bytes are no {} hashes or entries", bytes.len(), tile.width);
            Err(io::Error::new(ErrorKind::InvalidData, what))
        }
    }
}

/// A file's bytes, if there is such a file.
fn read(path: &Path, most: u64) -> io::Result<Option<Vec<u8>>> {
    match std::fs::metadata(path) {
        Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(None),
        Err(e) => Err(e),
        // A full tile and the folder of a larger index may share a name's beginning, never a name.
        Ok(there) if !there.is_file() => Ok(None),
        Ok(_) => Ok(read_limited_if_there(path, most)?),
    }
}

#[cfg(test)]
#[path = "http_tests.rs"]
mod tests;
