//! The names of a cohort's cases, which are the names of their folders.

use std::path::Path;

use super::jobs::Job;
use crate::cli::exit::Failure;
use crate::cli::output::manifest;

/// Endings that are no part of a name; a dot elsewhere is.
const ENDINGS: [&str; 15] = [
    ".seg.nrrd",
    ".nrrd",
    ".nhdr",
    ".mha",
    ".mhd",
    ".nii.gz",
    ".nii",
    ".vti",
    ".stl",
    ".vtp",
    ".vtk",
    ".ply",
    ".obj",
    ".yaml",
    ".yml",
];

/// The file's name without its ending; `a/case.yaml` and `b/mask.nrrd` are called by their folders.
pub fn name(input: &Path) -> String {
    let file = input.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let lower = file.to_ascii_lowercase();
    let stem = ENDINGS.iter().find(|e| lower.ends_with(*e)).map_or(file.as_str(), |e| &file[..file.len() - e.len()]);
    let folder = || {
        let parent = input.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let whole = parent
            .file_name()
            .map(|n| n.to_os_string())
            .or_else(|| parent.canonicalize().ok()?.file_name().map(|n| n.to_os_string()));
        whole.map(|n| n.to_string_lossy().into_owned())
    };
    match stem {
        "case" | "mask" => folder().unwrap_or_else(|| stem.to_string()),
        _ => stem.to_string(),
    }
}

/// Fails where two cases would share a folder, or a case's folder would be another file of the cohort.
pub fn check(jobs: &[Job]) -> Result<(), Failure> {
    // Some file systems do not tell capitals from small letters.
    let key = |name: &str| name.to_lowercase();
    for (i, job) in jobs.iter().enumerate() {
        let refused = |why: String| {
            Err(Failure::usage(format!(
                "{}: {why}; nothing was run: rename the file or its folder, or run it as a cohort of its own",
                job.input.display()
            )))
        };
        let own = key(&job.name);
        if own.is_empty() || own.starts_with('.') || own == manifest::FOLDER {
            return refused(format!("\"{}\" cannot be the name of a case's folder", job.name));
        }
        if super::folder::PAGES.contains(&own.as_str()) {
            return refused(format!("its folder would be called {}, as a page of the cohort", job.name));
        }
        if let Some(other) = jobs[..i].iter().find(|j| key(&j.name) == own) {
            let both = if other.input == job.input {
                match (job.own.is_empty(), job.own == other.own) {
                    (true, _) => "it is given twice".to_string(),
                    (false, true) => format!("the sweep gives {} twice", job.own.join(", ")),
                    (false, false) => format!(
                        "the sweep's values {} and {} give one name, {}",
                        other.own.join(", "),
                        job.own.join(", "),
                        job.name
                    ),
                }
            } else {
                format!("it and {} would share the folder {}", other.input.display(), job.name)
            };
            return refused(both);
        }
        for ending in [".log", ".exit"] {
            if let Some(other) = jobs.iter().find(|j| format!("{}{ending}", key(&j.name)) == own) {
                return refused(format!(
                    "its folder {} would have the name of a file of the case {}",
                    job.name, other.name
                ));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(input: &str, own: &[&str]) -> Job {
        let input = Path::new(input);
        let suffix: String = own.iter().map(|s| format!("_{}", s.replace(' ', "_"))).collect();
        Job {
            name: name(input) + &suffix,
            input: input.into(),
            yaml: false,
            set: vec![],
            own: own.iter().map(|s| s.to_string()).collect(),
        }
    }

    fn said(jobs: &[Job]) -> String {
        check(jobs).err().map(|e| e.message()).unwrap_or_default()
    }

    #[test]
    fn only_known_endings_are_no_part_of_a_name() {
        for (file, wanted) in [
            ("a/1.2.840.1.nrrd", "1.2.840.1"),
            ("a/1.2.840.2.nii.gz", "1.2.840.2"),
            ("b/left_carotid.nii.gz", "left_carotid"),
            ("b/Patient.A.SEG.NRRD", "Patient.A"),
            ("b/v1.5.yaml", "v1.5"),
            ("b/scan.2024", "scan.2024"),
            ("a/case.yaml", "a"),
            ("b.1/mask.nii.gz", "b.1"),
            ("b/mask.v2.nrrd", "mask.v2"),
        ] {
            assert_eq!(name(Path::new(file)), wanted, "{file}");
        }
    }

    #[test]
    fn two_cases_never_share_a_folder() {
        assert_eq!(said(&[job("a/1.2.1.nrrd", &[]), job("a/1.2.2.nrrd", &[]), job("a/1.2.nrrd", &[])]), "");
        assert!(said(&[job("a/x.nrrd", &[]), job("b/x.nii.gz", &[])]).contains("a/x.nrrd would share the folder x"));
        assert!(said(&[job("a/x.nrrd", &[]), job("a/X.nrrd", &[])]).contains("share"));
        assert!(said(&[job("a/x.nrrd", &[]), job("a/x.nrrd", &[])]).contains("given twice"));
        assert!(said(&[job("a/x.nrrd", &["s=1"]), job("a/x.nrrd", &["s=1"])]).contains("the sweep gives s=1 twice"));
        assert!(said(&[job("a/x.nrrd", &["s=0.5 mm"]), job("a/x.nrrd", &["s=0.5_mm"])]).contains("one name"));
    }

    #[test]
    fn a_folder_is_no_other_file_of_the_cohort() {
        assert!(said(&[job("cohort.csv.nrrd", &[])]).contains("page of the cohort"));
        assert!(said(&[job("a.log.nrrd", &[]), job("a.nrrd", &[])]).contains("file of the case a"));
        assert!(said(&[job(".nrrd", &[])]).contains("cannot be"));
        assert!(said(&[job(".lumenmesh.nrrd", &[])]).contains("cannot be"));
    }
}
