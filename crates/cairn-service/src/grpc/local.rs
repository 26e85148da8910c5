//! The socket in the data folder: a command on a folder that another process holds talks to that process.
//!
//! It lies in `DIR/socket`, a folder that no other user can enter, so whoever reaches it could open the data folder
//! themselves: no token is asked for, as in this process. What comes in goes on to the services of this process
//! ([`super::serve::InProcess`]); there is one way to call them.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use tokio::io::DuplexStream;
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::mpsc::UnboundedSender;
use tokio::sync::oneshot;
use tokio::task::{JoinHandle, JoinSet};

use super::pipe;

/// The socket's folder in the data folder.
const FOLDER: &str = "socket";
/// The socket in it.
const NAME: &str = "cairn";
/// Commands that are answered at the same time; a person runs a few.
const MAX_CONNECTIONS: usize = 64;
/// A system's address of a socket holds 108 bytes with the end (104 on some).
const MAX_ADDRESS_BYTES: usize = 100;
/// How often and how far apart a process is asked that has just taken the folder and still reads it.
const TRIES: u32 = 20;
const BETWEEN_TRIES: Duration = Duration::from_millis(100);
/// After that, a command that waits for others says so.
const SILENTLY: Duration = Duration::from_millis(300);
/// After a connection that could not be taken.
const PAUSE: Duration = Duration::from_millis(100);

/// A socket at work.
pub(super) struct Socket {
    folder: PathBuf,
    stop: oneshot::Sender<()>,
    accepting: JoinHandle<()>,
}

impl Socket {
    /// Listens in the data folder `data`, whose lock this process holds, and passes on what comes to `services`.
    ///
    /// # Errors
    /// The file system's.
    pub(super) fn listen(data: &Path, services: UnboundedSender<io::Result<DuplexStream>>) -> io::Result<Self> {
        use std::os::unix::fs::DirBuilderExt as _;
        let folder = data.join(FOLDER);
        // What a process left that was killed.
        if folder.exists() {
            fs::remove_dir_all(&folder)?;
        }
        fs::DirBuilder::new().mode(0o700).create(&folder)?;
        let listener = UnixListener::bind(Address::of(&folder)?.path)?;
        let (stop, stopped) = oneshot::channel();
        let accepting = tokio::spawn(accept(listener, services, stopped));
        Ok(Self { folder, stop, accepting })
    }

    /// Takes no more connections, and waits for those that are open.
    pub(super) async fn close(mut self) {
        // Nobody finds it from here on; where that fails the next owner clears it away.
        let _ = fs::remove_dir_all(&self.folder);
        let _ = self.stop.send(());
        if tokio::time::timeout(SILENTLY, &mut self.accepting).await.is_err() {
            tracing::warn!("another command works on the data folder through this process, which ends when that does");
            // A panic was reported on its own thread.
            let _ = self.accepting.await;
        }
    }

    /// As [`Socket::close`], for `grace` at most.
    pub(super) async fn close_within(self, grace: Duration) {
        let _ = fs::remove_dir_all(&self.folder);
        let _ = self.stop.send(());
        let _ = tokio::time::timeout(grace, self.accepting).await;
    }
}

async fn accept(
    listener: UnixListener,
    services: UnboundedSender<io::Result<DuplexStream>>,
    mut stopped: oneshot::Receiver<()>,
) {
    let mut open = JoinSet::new();
    loop {
        tokio::select! {
            // An error means that the sender is gone: stop as well.
            _ = &mut stopped => break,
            Some(_) = open.join_next(), if !open.is_empty() => {}
            accepted = listener.accept(), if open.len() < MAX_CONNECTIONS => match accepted {
                Ok((stream, _)) => {
                    let (ours, theirs) = pipe();
                    if services.send(Ok(theirs)).is_err() {
                        break;
                    }
                    open.spawn(pass(stream, ours));
                }
                Err(error) => {
                    tracing::warn!(%error, "a connection to the data folder's socket was not taken");
                    tokio::time::sleep(PAUSE).await;
                }
            },
        }
    }
    while open.join_next().await.is_some() {}
}

/// Carries bytes both ways until either side ends.
async fn pass(mut stream: UnixStream, mut services: DuplexStream) {
    // Either side may break off at any time; the other hears of it.
    let _ = tokio::io::copy_bidirectional(&mut stream, &mut services).await;
}

/// A connection to the process that holds the data folder `data`, which may have begun just now.
///
/// # Errors
/// The system's, where nobody listens.
pub async fn connect(data: &Path) -> io::Result<UnixStream> {
    let mut tries = 0;
    loop {
        let connected = match Address::of(&data.join(FOLDER)) {
            Ok(address) => UnixStream::connect(&address.path).await,
            Err(error) => Err(error),
        };
        match connected {
            Err(_) if tries < TRIES => tries += 1,
            ended => return ended,
        }
        tokio::time::sleep(BETWEEN_TRIES).await;
    }
}

/// Where the socket is, in a form that is short enough for the system.
struct Address {
    path: PathBuf,
    /// Open for as long as the path goes through its number.
    _folder: Option<File>,
}

impl Address {
    fn of(folder: &Path) -> io::Result<Self> {
        let path = folder.join(NAME);
        if path.as_os_str().len() <= MAX_ADDRESS_BYTES || !cfg!(target_os = "linux") {
            return Ok(Self { path, _folder: None });
        }
        use std::os::fd::AsRawFd as _;
        let opened = File::open(folder)?;
        let path = PathBuf::from(format!("/proc/self/fd/{}/{NAME}", opened.as_raw_fd()));
        Ok(Self { path, _folder: Some(opened) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt as _;
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

    /// A service that sends back what it gets.
    fn echo() -> UnboundedSender<io::Result<DuplexStream>> {
        let (sender, mut incoming) = tokio::sync::mpsc::unbounded_channel::<io::Result<DuplexStream>>();
        tokio::spawn(async move {
            while let Some(Ok(stream)) = incoming.recv().await {
                let (mut reader, mut writer) = tokio::io::split(stream);
                tokio::spawn(async move { tokio::io::copy(&mut reader, &mut writer).await });
            }
        });
        sender
    }

    async fn echoed(data: &Path, what: &[u8]) -> Vec<u8> {
        let mut stream = connect(data).await.unwrap();
        stream.write_all(what).await.unwrap();
        let mut back = vec![0; what.len()];
        stream.read_exact(&mut back).await.unwrap();
        back
    }

    #[tokio::test]
    async fn what_comes_in_is_passed_on_and_an_open_connection_is_waited_for() {
        let dir = tempfile::tempdir().unwrap();
        // Longer than a system's address.
        for data in [dir.path().to_path_buf(), dir.path().join("d".repeat(120))] {
            fs::create_dir_all(&data).unwrap();
            // Left by a process that was killed.
            fs::create_dir_all(data.join(FOLDER)).unwrap();
            fs::write(data.join(FOLDER).join(NAME), "stale").unwrap();
            let socket = Socket::listen(&data, echo()).unwrap();
            assert_eq!(fs::metadata(data.join(FOLDER)).unwrap().permissions().mode() & 0o777, 0o700);
            assert_eq!(echoed(&data, b"a call").await, b"a call");
            let held = connect(&data).await.unwrap();
            let closing = tokio::spawn(socket.close());
            tokio::time::sleep(Duration::from_millis(50)).await;
            assert!(!closing.is_finished() && !data.join(FOLDER).exists());
            drop(held);
            closing.await.unwrap();
        }
    }
}
