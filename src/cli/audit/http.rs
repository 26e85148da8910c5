//! A log's public files over plain HTTP (C2SP tlog-tiles).

use std::time::Duration;

use cairn_verify::{Fetch, FollowError};
use ureq::Agent;

/// Longest that one file takes, connecting included.
const TIMEOUT: Duration = Duration::from_secs(30);
/// Largest head of an answer, bytes.
const MAX_HEAD_BYTES: usize = 16 << 10;

/// A log at an address. Follows no redirect: the host that was named answers, or none does.
pub struct HttpLog {
    agent: Agent,
    url: String,
}

impl HttpLog {
    /// The log whose files lie below `url`.
    ///
    /// # Errors
    /// For another scheme than http or https, and for an address with a query.
    pub fn new(url: &str) -> anyhow::Result<Self> {
        let known = url.starts_with("http://") || url.starts_with("https://");
        anyhow::ensure!(
            known && !url.contains(['?', '#', '@']),
            "address {url:?}: expected http:// or https://, a host, and the log's prefix"
        );
        let config = Agent::config_builder()
            .timeout_global(Some(TIMEOUT))
            .http_status_as_error(false)
            .max_redirects(0)
            .max_redirects_will_error(false)
            .max_response_header_size(MAX_HEAD_BYTES)
            .user_agent(concat!("cairn/", env!("CARGO_PKG_VERSION")));
        Ok(Self { agent: config.build().new_agent(), url: url.trim_end_matches('/').to_owned() })
    }
}

/// What went wrong, and for an answer that is none of plain HTTP what it mostly is.
fn in_words(error: &ureq::Error) -> String {
    match error {
        ureq::Error::Protocol(_) | ureq::Error::Http(_) => format!(
            "{error}: no plain HTTP is spoken there; a log's files lie at `registry.http_bind` of its daemon's settings, not \
             where commands connect"
        ),
        _ => error.to_string(),
    }
}

impl Fetch for HttpLog {
    fn fetch(&self, path: &str, limit: usize) -> Result<Option<Vec<u8>>, FollowError> {
        let url = format!("{}/{path}", self.url);
        let failed = |cause: String| FollowError::Fetch { path: url.clone(), cause };
        let mut response = self.agent.get(&url).call().map_err(|e| failed(in_words(&e)))?;
        match response.status().as_u16() {
            200 => {
                let body = response.body_mut().with_config().limit(limit as u64 + 1).read_to_vec();
                let body = body.map_err(|e| failed(e.to_string()))?;
                if body.len() > limit { Err(failed(format!("more than {limit} bytes"))) } else { Ok(Some(body)) }
            }
            404 => Ok(None),
            status => Err(failed(format!("status {status}"))),
        }
    }
}
