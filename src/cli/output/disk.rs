//! The file operations that put results in place, one by one, so that a test can let each of them fail.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::Path;

#[cfg(not(test))]
fn step(_: &Path) -> io::Result<()> {
    Ok(())
}
#[cfg(test)]
use fault::step;

/// Makes a folder; its parent must be there.
pub fn create_dir(path: &Path) -> io::Result<()> {
    step(path)?;
    fs::create_dir(path)
}

/// Makes a folder and its parents.
pub fn create_dir_all(path: &Path) -> io::Result<()> {
    step(path)?;
    fs::create_dir_all(path)
}

/// Writes a file and waits until the disk has it.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    #[cfg(test)]
    fault::half(path, bytes)?;
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    reach_the_disk(&file)
}

/// Waits until the disk has a file, and tells of writes that failed after they seemed done (quotas, network disks).
pub fn sync(path: &Path) -> io::Result<()> {
    step(path)?;
    reach_the_disk(&File::open(path)?)
}

fn reach_the_disk(file: &File) -> io::Result<()> {
    // The tests here see what stands in memory; waiting for the disk a thousand times would take minutes.
    if cfg!(test) { Ok(()) } else { file.sync_all() }
}

/// Moves `from` to `to`, which may be an empty folder.
pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
    step(to)?;
    fs::rename(from, to)
}

/// Moves `from` to `to` unless there is something at `to`.
pub fn rename_new(from: &Path, to: &Path) -> io::Result<()> {
    step(to)?;
    match flagged::rename_new(from, to) {
        Err(e) if unsupported(&e) => {
            if fs::symlink_metadata(to).is_ok() {
                return Err(ErrorKind::AlreadyExists.into());
            }
            fs::rename(from, to)
        }
        done => done,
    }
}

/// Exchanges two folders in one step; `false` where the system has no such step, and nothing was done.
pub fn exchange(a: &Path, b: &Path) -> io::Result<bool> {
    step(b)?;
    #[cfg(test)]
    if fault::no_exchange() {
        return Ok(false);
    }
    match flagged::exchange(a, b) {
        Ok(()) => Ok(true),
        Err(e) if unsupported(&e) => Ok(false),
        Err(e) => Err(e),
    }
}

/// Removes a file or link.
pub fn remove_file(path: &Path) -> io::Result<()> {
    step(path)?;
    fs::remove_file(path)
}

/// Removes an empty folder.
pub fn remove_dir(path: &Path) -> io::Result<()> {
    step(path)?;
    fs::remove_dir(path)
}

/// Removes a folder with all that is in it.
pub fn remove_dir_all(path: &Path) -> io::Result<()> {
    step(path)?;
    fs::remove_dir_all(path)
}

/// The file system or the system does not know the operation.
pub fn unsupported(e: &io::Error) -> bool {
    use rustix::io::Errno;
    let known = [Errno::INVAL, Errno::NOSYS, Errno::OPNOTSUPP, Errno::NOTSUP, Errno::NOLCK];
    e.kind() == ErrorKind::Unsupported || e.raw_os_error().is_some_and(|n| known.iter().any(|k| k.raw_os_error() == n))
}

#[cfg(any(target_os = "linux", target_vendor = "apple"))]
mod flagged {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    use std::io;
    use std::path::Path;

    pub fn rename_new(from: &Path, to: &Path) -> io::Result<()> {
        Ok(renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE)?)
    }

    pub fn exchange(a: &Path, b: &Path) -> io::Result<()> {
        Ok(renameat_with(CWD, a, CWD, b, RenameFlags::EXCHANGE)?)
    }
}

#[cfg(not(any(target_os = "linux", target_vendor = "apple")))]
mod flagged {
    use std::io::{self, ErrorKind};
    use std::path::Path;

    pub fn rename_new(_: &Path, _: &Path) -> io::Result<()> {
        Err(ErrorKind::Unsupported.into())
    }

    pub fn exchange(_: &Path, _: &Path) -> io::Result<()> {
        Err(ErrorKind::Unsupported.into())
    }
}

/// Faults for tests, in the thread that asks for them.
#[cfg(test)]
pub mod fault {
    use std::cell::RefCell;
    use std::io::{self, ErrorKind};
    use std::path::Path;

    /// What happens at a step.
    pub enum Fault {
        /// The step fails, the next ones do not.
        Fail(ErrorKind),
        /// The process is gone: this step and all after it do nothing.
        Die,
        /// Somebody else does something before the step.
        Meanwhile(Box<dyn FnOnce()>),
    }

    #[derive(Default)]
    struct Plan {
        steps: usize,
        at: usize,
        fault: Option<Fault>,
        dead: bool,
        no_exchange: bool,
    }

    thread_local! {
        static PLAN: RefCell<Plan> = RefCell::default();
    }

    /// Lets step `at` (from 1) go wrong.
    pub fn plan(at: usize, fault: Fault, no_exchange: bool) {
        PLAN.with_borrow_mut(|p| *p = Plan { at, fault: Some(fault), no_exchange, ..Plan::default() });
    }

    /// Ends the plan; gives the steps that were taken.
    pub fn clear() -> usize {
        PLAN.with_borrow_mut(std::mem::take).steps
    }

    /// A step that leaves half of a file where it fails.
    pub fn half(path: &Path, bytes: &[u8]) -> io::Result<()> {
        step(path).inspect_err(|e| {
            if e.kind() != ErrorKind::BrokenPipe {
                let _ = std::fs::write(path, &bytes[..bytes.len() / 2]);
            }
        })
    }

    pub fn no_exchange() -> bool {
        PLAN.with_borrow(|p| p.no_exchange)
    }

    pub fn step(_: &Path) -> io::Result<()> {
        let meanwhile = PLAN.with_borrow_mut(|p| {
            if p.dead {
                return Err(ErrorKind::BrokenPipe.into());
            }
            p.steps += 1;
            if p.steps != p.at {
                return Ok(None);
            }
            match p.fault.take() {
                Some(Fault::Fail(kind)) => Err(kind.into()),
                Some(Fault::Die) => {
                    p.dead = true;
                    Err(io::Error::other("gone"))
                }
                Some(Fault::Meanwhile(act)) => Ok(Some(act)),
                None => Ok(None),
            }
        })?;
        if let Some(act) = meanwhile {
            act();
        }
        Ok(())
    }
}
