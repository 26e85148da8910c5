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
/// The socket in it, of a daemon.
const DAEMON: &str = "daemon";
/// The socket in it, of a command, which ends when it has done its own work.
const COMMAND: &str = "command";
/// Commands that are answered at the same time; a person runs a few.
const MAX_CONNECTIONS: usize = 64;
/// A system's address of a socket holds 108 bytes with the end (104 on some).
const MAX_ADDRESS_BYTES: usize = 100;
/// After that, a command that waits for others says so.
const SILENTLY: Duration = Duration::from_millis(300);
/// After a connection that could not be taken.
const PAUSE: Duration = Duration::from_millis(100);

/// Who holds a data folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Holder {
    /// A daemon: it stays.
    Daemon,
    /// A command: it ends when it has done its own work, and the commands that came through it theirs.
    Command,
}

impl Holder {
    const fn socket(self) -> &'static str {
        match self {
            Self::Daemon => DAEMON,
            Self::Command => COMMAND,
        }
    }
}

/// A socket at work.
pub(super) struct Socket {
    folder: PathBuf,
    stop: oneshot::Sender<()>,
    accepting: JoinHandle<()>,
}

impl Socket {
    /// Listens in the data folder `data`, whose lock this process, `holder`, has, and passes on what comes to `services`.
    ///
    /// # Errors
    /// The file system's.
    pub(super) fn listen(
        data: &Path,
        holder: Holder,
        services: UnboundedSender<io::Result<DuplexStream>>,
    ) -> io::Result<Self> {
        use std::os::unix::fs::DirBuilderExt as _;
        let folder = data.join(FOLDER);
        // What a process left that was killed.
        if folder.exists() {
            fs::remove_dir_all(&folder)?;
        }
        fs::DirBuilder::new().mode(0o700).create(&folder)?;
        let listener = UnixListener::bind(Address::of(&folder, holder)?.path)?;
        let (stop, stopped) = oneshot::channel();
        let accepting = tokio::spawn(accept(listener, services, stopped));
        Ok(Self { folder, stop, accepting })
    }

    /// Waits until no connection is open, and takes no more then: until that others still find the folder answered for.
    pub(super) async fn close(mut self) {
        let _ = self.stop.send(());
        if tokio::time::timeout(SILENTLY, &mut self.accepting).await.is_err() {
            tracing::warn!(
                "done; another command still works on the data folder through this process, which waits for it; Ctrl-C cuts it off"
            );
            tokio::select! {
                // A panic was reported on its own thread.
                _ = &mut self.accepting => {}
                _ = tokio::signal::ctrl_c() => self.accepting.abort(),
            }
        }
        hide(&self.folder);
    }

    /// Lets nobody find it any more.
    pub(super) fn hide(&self) {
        hide(&self.folder);
    }

    /// As [`Socket::close`], for `grace` at most.
    pub(super) async fn close_within(self, grace: Duration) {
        self.hide();
        let _ = self.stop.send(());
        let _ = tokio::time::timeout(grace, self.accepting).await;
    }
}

fn hide(folder: &Path) {
    // Where that fails the next owner clears it away.
    let _ = fs::remove_dir_all(folder);
}

async fn accept(
    listener: UnixListener,
    services: UnboundedSender<io::Result<DuplexStream>>,
    mut stopped: oneshot::Receiver<()>,
) {
    let mut open = JoinSet::new();
    let take = |stream, open: &mut JoinSet<()>| {
        let (ours, theirs) = pipe();
        let taken = services.send(Ok(theirs)).is_ok();
        if taken {
            open.spawn(pass(stream, ours));
        }
        taken
    };
    let mut closing = false;
    while !(closing && open.is_empty()) {
        tokio::select! {
            // An error means that the sender is gone: stop as well.
            _ = &mut stopped, if !closing => closing = true,
            Some(_) = open.join_next(), if !open.is_empty() => {}
            accepted = listener.accept(), if open.len() < MAX_CONNECTIONS => match accepted {
                Ok((stream, _)) => {
                    if !take(stream, &mut open) {
                        break;
                    }
                }
                Err(error) => {
                    tracing::warn!(%error, "a connection to the data folder's socket was not taken");
                    tokio::time::sleep(PAUSE).await;
                }
            },
        }
    }
    // Who connected a moment ago was let in already.
    while let Ok(Ok((stream, _))) = tokio::time::timeout(Duration::ZERO, listener.accept()).await {
        if open.len() >= MAX_CONNECTIONS || !take(stream, &mut open) {
            break;
        }
    }
    drop(listener);
    while open.join_next().await.is_some() {}
}

/// Carries bytes both ways until either side ends.
async fn pass(mut stream: UnixStream, mut services: DuplexStream) {
    // Either side may break off at any time; the other hears of it.
    let _ = tokio::io::copy_bidirectional(&mut stream, &mut services).await;
}

/// A connection to the process that holds the data folder `data`, and who that is.
///
/// # Errors
/// The system's, where nobody listens.
pub async fn connect(data: &Path) -> io::Result<(UnixStream, Holder)> {
    let folder = data.join(FOLDER);
    match UnixStream::connect(&Address::of(&folder, Holder::Daemon)?.path).await {
        Ok(stream) => Ok((stream, Holder::Daemon)),
        Err(_) => {
            let stream = UnixStream::connect(&Address::of(&folder, Holder::Command)?.path).await?;
            Ok((stream, Holder::Command))
        }
    }
}

/// Where the socket is, in a form that is short enough for the system.
struct Address {
    path: PathBuf,
    /// Open for as long as the path goes through its number.
    _folder: Option<File>,
}

impl Address {
    fn of(folder: &Path, holder: Holder) -> io::Result<Self> {
        let name = holder.socket();
        let path = folder.join(name);
        if path.as_os_str().len() <= MAX_ADDRESS_BYTES || !cfg!(target_os = "linux") {
            return Ok(Self { path, _folder: None });
        }
        use std::os::fd::AsRawFd as _;
        let opened = File::open(folder)?;
        let path = PathBuf::from(format!("/proc/self/fd/{}/{name}", opened.as_raw_fd()));
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
        let (mut stream, _) = connect(data).await.unwrap();
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
            fs::write(data.join(FOLDER).join(COMMAND), "stale").unwrap();
            assert!(connect(&data).await.is_err());
            let socket = Socket::listen(&data, Holder::Daemon, echo()).unwrap();
            assert_eq!(fs::metadata(data.join(FOLDER)).unwrap().permissions().mode() & 0o777, 0o700);
            assert_eq!(echoed(&data, b"a call").await, b"a call");
            let (mut held, holder) = connect(&data).await.unwrap();
            assert_eq!(holder, Holder::Daemon);
            let closing = tokio::spawn(socket.close());
            tokio::time::sleep(Duration::from_millis(50)).await;
            assert!(!closing.is_finished());
            // It is answered to its end, and so are others until then.
            assert_eq!(echoed(&data, b"another").await, b"another");
            held.write_all(b"more").await.unwrap();
            let mut back = [0; 4];
            held.read_exact(&mut back).await.unwrap();
            assert_eq!(&back, b"more");
            drop(held);
            closing.await.unwrap();
            assert!(!data.join(FOLDER).exists());
        }
    }
}
