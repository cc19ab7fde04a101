//! `lumenmesh phantom`: built-in cases with exact truth.

use serde_json::Value;

use super::args::PhantomArgs;
use super::exit::{self, Failure};
use super::output::manifest::Origin;
use super::output::{self, Earlier, Staging, write};
use crate::io::nrrd;
use crate::mask::Mask;
use crate::phantom;

/// `lumenmesh phantom NAME|list -o DIR`
pub fn run(args: &PhantomArgs) -> Result<u8, Failure> {
    if args.name == "list" {
        for name in phantom::list() {
            say!("{name}");
        }
        for kind in phantom::kinds() {
            say!("{kind}-SEED");
        }
        return Ok(0);
    }
    if let Some(sample) = phantom::sample_by_name(&args.name) {
        let case = format!("# {}\ninput:\n  mask: mask.nrrd\n", sample.description);
        return publish(args, &sample.mask, &sample.truth_json(), &case);
    }
    let phantom = phantom::build(&args.name).map_err(|e| Failure::new(exit::USAGE, e))?;
    let mask = phantom.mask();
    publish(args, &mask, &phantom.truth_json(&mask.grid), &phantom.case_yaml("mask.nrrd"))
}

/// Writes the mask, what is known exactly of it, and a case that meshes it.
fn publish(args: &PhantomArgs, mask: &Mask, truth: &Value, case: &str) -> Result<u8, Failure> {
    let dir = args.output.clone().unwrap_or_else(|| args.name.clone().into());
    let staging = Staging::new(&dir, Earlier::from_flag(args.keep))?;
    let file = staging.path().join("mask.nrrd");
    nrrd::write_mask(&file, mask).map_err(|e| Failure::new(exit::USAGE, e))?;
    let truth = serde_json::to_string_pretty(truth).map_err(|e| Failure::new(exit::USAGE, e))?;
    write(&staging.path().join("truth.json"), format!("{truth}\n").as_bytes())?;
    write(&staging.path().join("case.yaml"), case.as_bytes())?;
    output::tell_kept(staging.publish(Origin { command: "phantom", case: None })?.as_deref());
    say!("{}: {} lumen voxels; mask.nrrd, truth.json, case.yaml in {}", args.name, mask.count(), dir.display());
    Ok(0)
}
