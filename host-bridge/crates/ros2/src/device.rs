//! The sockets of the node, tied to the loopback device where the configuration asks for loopback alone.
//!
//! RustDDS binds its listeners to 0.0.0.0 whatever networks are chosen, so that anybody who can reach this machine can
//! send to them. On Linux a socket can be tied to a device after the fact; elsewhere that is not done, and said.

#[cfg(target_os = "linux")]
pub use linux::{sockets, tie_to_loopback};

#[cfg(target_os = "linux")]
mod linux {
    use std::collections::BTreeSet;
    use std::io;

    use rustix::process::{PidfdFlags, PidfdGetfdFlags, getpid, pidfd_getfd, pidfd_open};
    use socket2::SockRef;

    /// The numbers of this process's open sockets.
    pub fn sockets() -> BTreeSet<i32> {
        let open = std::fs::read_dir("/proc/self/fd").into_iter().flatten().flatten();
        let is_socket = |entry: &std::fs::DirEntry| {
            std::fs::read_link(entry.path()).is_ok_and(|to| to.to_string_lossy().starts_with("socket:"))
        };
        open.filter(is_socket).filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect()
    }

    /// Ties every UDP socket to the loopback device that was opened since `before` was taken. Returns how many.
    ///
    /// # Errors
    /// What the system refuses: Linux before 5.7 allows this to root only.
    pub fn tie_to_loopback(before: &BTreeSet<i32>) -> io::Result<usize> {
        let process = pidfd_open(getpid(), PidfdFlags::empty())?;
        let mut tied = 0;
        for number in sockets().difference(before) {
            // One that was closed meanwhile needs nothing.
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
