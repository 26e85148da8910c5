//! The public files over HTTP: what is served, as what, and that nothing else is.

use axum::body::{Body, to_bytes};
use axum::http::Request;
use cairn_log::format::tile::encode_entries;
use tower::ServiceExt as _;

use super::*;

/// A folder with a checkpoint, a full and a partial tile of either kind, and a file that is nobody's business.
fn public() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let put = |name: &str, bytes: &[u8]| {
        let path = dir.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    };
    put("registry.key", b"secret");
    put("public/checkpoint", b"log\n300\n");
    put("public/tile/0/000", &hashes(256));
    put("public/tile/0/001.p/44", &hashes(44));
    put("public/tile/entries/000", &entries(256));
    put("public/tile/entries/001.p/44", &entries(44));
    put("public/tile/0/x001/000", b"short");
    put("public/other", b"other");
    dir
}

fn hashes(count: usize) -> Vec<u8> {
    (0..count).flat_map(|i| [i as u8; 32]).collect()
}

fn entries(count: usize) -> Vec<u8> {
    let entries: Vec<Vec<u8>> = (0..count).map(|i| vec![i as u8; i % 7]).collect();
    encode_entries(entries.iter().map(Vec::as_slice)).unwrap()
}

async fn ask(dir: &Path, prefix: &str, method: &str, path: &str) -> (u16, String, String, Vec<u8>) {
    let request = Request::builder().method(method).uri(path).body(Body::empty()).unwrap();
    let response = router(dir.join("public"), prefix).oneshot(request).await.unwrap();
    let head = |name| response.headers().get(name).map_or("", |v| v.to_str().unwrap()).to_owned();
    let (status, kind, caching) = (response.status().as_u16(), head(header::CONTENT_TYPE), head(header::CACHE_CONTROL));
    (status, kind, caching, to_bytes(response.into_body(), 1 << 20).await.unwrap().to_vec())
}

#[tokio::test]
async fn checkpoint_and_tiles_are_served() {
    let dir = public();
    let checkpoint = (200, NOTE.to_owned(), "no-cache".to_owned(), b"log\n300\n".to_vec());
    assert_eq!(ask(dir.path(), "", "GET", "/checkpoint").await, checkpoint);
    for (path, bytes) in [
        ("/tile/0/000", hashes(256)),
        ("/tile/0/001.p/44", hashes(44)),
        ("/tile/entries/000", entries(256)),
        ("/tile/entries/001.p/44", entries(44)),
        // Gone, and cut from the full ones.
        ("/tile/0/000.p/1", hashes(1)),
        ("/tile/0/000.p/255", hashes(255)),
        ("/tile/entries/000.p/1", entries(1)),
        ("/tile/entries/000.p/255", entries(255)),
    ] {
        let (status, kind, caching, got) = ask(dir.path(), "", "GET", path).await;
        assert_eq!((status, kind.as_str()), (200, BYTES), "{path}");
        assert!(caching.contains("immutable"), "{path}: {caching}");
        assert_eq!(got, bytes, "{path}");
    }
    let (status, _, _, body) = ask(dir.path(), "", "HEAD", "/tile/0/000").await;
    assert_eq!((status, body.len()), (200, 0));
}

#[tokio::test]
async fn nothing_else_is() {
    let dir = public();
    for path in [
        "/",
        "/other",
        "/registry.key",
        "/../registry.key",
        "/tile/../checkpoint",
        "/tile/0/..%2f..%2f..%2fregistry.key",
        "/%2e%2e/registry.key",
        "//checkpoint",
        "/checkpoint/",
        "/Checkpoint",
        "/check%70oint",
        "/tile",
        "/tile/0",
        "/tile/0/0",
        "/tile/0/002",
        "/tile/0/002.p/1",
        "/tile/0/001",
        "/tile/0/001.p/43",
        "/tile/1/000",
        "/tile/00/000",
        "/tile/0/x000/000",
        "/tile/0/000.p/256",
        "/tile/entries/x001",
        "/log/checkpoint",
    ] {
        assert_eq!(ask(dir.path(), "", "GET", path).await.0, 404, "{path}");
    }
    for method in ["POST", "PUT", "DELETE"] {
        assert_eq!(ask(dir.path(), "", method, "/checkpoint").await.0, 405, "{method}");
    }
    // A tile that is not what its name says is a fault of the store's, and not handed on.
    assert_eq!(ask(dir.path(), "", "GET", "/tile/0/x001/000").await.0, 500);
    let empty = tempfile::tempdir().unwrap();
    assert_eq!(ask(empty.path(), "", "GET", "/checkpoint").await.0, 404, "before the first publication");
}

#[tokio::test]
async fn a_prefix_comes_in_front() {
    let dir = public();
    assert_eq!(ask(dir.path(), "/logs/one", "GET", "/logs/one/checkpoint").await.0, 200);
    assert_eq!(ask(dir.path(), "/logs/one", "GET", "/logs/one/tile/0/000").await.0, 200);
    for path in ["/checkpoint", "/logs/onecheckpoint", "/logs/one", "/logs/one/", "/logs/one/logs/one/checkpoint"] {
        assert_eq!(ask(dir.path(), "/logs/one", "GET", path).await.0, 404, "{path}");
    }
}
