//! The memory that the runs of a cohort share.

use std::sync::atomic::Ordering;
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

use crate::cli::console::CANCELLED;

/// Hands out memory; a run waits until its share is free.
pub struct Room {
    limit: u64,
    /// Bytes taken and runs going on.
    used: Mutex<(u64, usize)>,
    freed: Condvar,
}

/// A run's share, given back when it drops.
pub struct Place<'a> {
    room: &'a Room,
    bytes: u64,
}

impl Room {
    /// `gib` in all, or four fifths of what the machine has free.
    pub fn new(gib: Option<f64>) -> Room {
        let limit = match gib {
            Some(g) => (g * f64::from(1u32 << 30)) as u64,
            None => available().map_or(u64::MAX, |b| b / 5 * 4),
        };
        Room { limit, used: Mutex::new((0, 0)), freed: Condvar::new() }
    }

    /// Waits until `bytes` are free. A run that needs more than there is waits until it is alone.
    pub fn take(&self, bytes: u64) -> Place<'_> {
        let mut used = self.used.lock().unwrap_or_else(PoisonError::into_inner);
        while used.1 > 0 && used.0.saturating_add(bytes) > self.limit && !CANCELLED.load(Ordering::Relaxed) {
            used = self.freed.wait_timeout(used, Duration::from_millis(200)).unwrap_or_else(PoisonError::into_inner).0;
        }
        *used = (used.0.saturating_add(bytes), used.1 + 1);
        Place { room: self, bytes }
    }
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        let mut used = self.room.used.lock().unwrap_or_else(PoisonError::into_inner);
        *used = (used.0.saturating_sub(self.bytes), used.1 - 1);
        drop(used);
        self.room.freed.notify_all();
    }
}

/// Memory that the machine has free, bytes; `None` where the system does not tell.
fn available() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find(|l| l.starts_with("MemAvailable:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicUsize;

    #[test]
    fn runs_wait_for_memory_and_a_large_one_runs_alone() {
        let room = Room { limit: 100, used: Mutex::new((0, 0)), freed: Condvar::new() };
        let (running, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        std::thread::scope(|s| {
            for bytes in [60, 60, 60, 500, 30, 30] {
                let (room, running, most) = (&room, &running, &most);
                s.spawn(move || {
                    let _place = room.take(bytes);
                    running.fetch_add(bytes as usize, Ordering::SeqCst);
                    let now = running.load(Ordering::SeqCst);
                    assert!(now <= 100 || now == 500, "{now} bytes at a time");
                    most.fetch_max(now, Ordering::SeqCst);
                    std::thread::sleep(Duration::from_millis(20));
                    running.fetch_sub(bytes as usize, Ordering::SeqCst);
                });
            }
        });
        assert!(most.load(Ordering::SeqCst) >= 90, "two small ones fit together");
        assert_eq!(*room.used.lock().expect("free"), (0, 0));
    }
}
