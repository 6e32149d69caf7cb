//! Binds the node's sockets to the loopback device, if the configuration requires loopback only.
//!
//! RustDDS binds its listeners to 0.0.0.0, whatever networks are chosen.
//! Anyone who can reach this machine can therefore send data to these listeners.
//! On Linux, a socket can be bound to a device later.
//! Other systems do not permit this, and a message reports it.

#[cfg(target_os = "linux")]
pub use linux::{sockets, tie_to_loopback};

#[cfg(target_os = "linux")]
mod linux {
    use std::collections::BTreeSet;
    use std::io;

    use rustix::process::{PidfdFlags, PidfdGetfdFlags, getpid, pidfd_getfd, pidfd_open};
    use socket2::SockRef;

    /// Returns the numbers of this process's open sockets.
    pub fn sockets() -> BTreeSet<i32> {
        let open = std::fs::read_dir("/proc/self/fd").into_iter().flatten().flatten();
        let is_socket = |entry: &std::fs::DirEntry| {
            std::fs::read_link(entry.path()).is_ok_and(|to| to.to_string_lossy().starts_with("socket:"))
        };
        open.filter(is_socket).filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect()
    }

    /// Binds every UDP socket that was opened after `before` to the loopback device. Returns their number.
    ///
    /// # Errors
    /// Returns the system's refusal. Before Linux 5.7, only root may bind a socket to a device.
    pub fn tie_to_loopback(before: &BTreeSet<i32>) -> io::Result<usize> {
        let process = pidfd_open(getpid(), PidfdFlags::empty())?;
        let mut tied = 0;
        for number in sockets().difference(before) {
            // A socket that was closed in the meantime can be ignored.
            let Ok(socket) = pidfd_getfd(&process, *number, PidfdGetfdFlags::empty()) else { continue };
            let socket = SockRef::from(&socket);
            let is_udp = matches!(socket.r#type(), Ok(kind) if kind == socket2::Type::DGRAM)
                && socket.local_addr().is_ok_and(|address| address.as_socket().is_some());
            if is_udp {
                socket.bind_device(Some(b"lo"))?;
                tied += 1;
            }
        }
        Ok(tied)
    }

    #[cfg(test)]
    mod tests {
        use std::net::UdpSocket;

        use super::*;

        #[test]
        fn only_sockets_that_came_later_are_tied() {
            let earlier = UdpSocket::bind("0.0.0.0:0").unwrap();
            let before = sockets();
            let later = UdpSocket::bind("0.0.0.0:0").unwrap();
            assert!(tie_to_loopback(&before).unwrap() >= 1);
            assert_eq!(SockRef::from(&later).device().unwrap(), Some(b"lo".to_vec()));
            assert_eq!(SockRef::from(&earlier).device().unwrap(), None);
        }
    }
}
