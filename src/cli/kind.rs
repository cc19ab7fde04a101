//! Files given to the wrong command: which one is meant.

use std::path::Path;

use super::exit::Failure;

/// Endings of images and surfaces, in lower case.
const INPUTS: [&str; 12] =
    [".nrrd", ".nhdr", ".mha", ".mhd", ".nii", ".nii.gz", ".vti", ".stl", ".vtp", ".ply", ".vtk", ".obj"];

fn ends_in(path: &Path, endings: &[&str]) -> bool {
    let name = path.to_string_lossy().to_lowercase();
    endings.iter().any(|e| name.ends_with(e))
}

/// Refuses an image or surface where a case file belongs.
pub fn is_case(path: &Path) -> Result<(), Failure> {
    if !ends_in(path, &INPUTS) {
        return Ok(());
    }
    let file = path.display();
    Err(Failure::usage(format!(
        "{file}: is an image or surface, not a case file: use `lumenmesh mesh {file} -o out`, or write a case with `lumenmesh init {file} -o case.yaml`"
    )))
}

/// Refuses a case file where an image or surface belongs. `command` is the one that was called.
pub fn is_input(path: &Path, command: &str) -> Result<(), Failure> {
    if !ends_in(path, &[".yaml", ".yml"]) {
        return Ok(());
    }
    let file = path.display();
    Err(Failure::usage(format!(
        "{file}: is a case file, and `{command}` takes an image or surface: use `lumenmesh run {file} -o out`"
    )))
}

/// Refuses a folder without a mesh where `check` wants one, and names meshes in it.
pub fn is_mesh(path: &Path) -> Result<(), Failure> {
    let foam = ["constant", "points", "points.gz", "polyMesh"].iter().any(|n| path.join(n).exists());
    if !path.is_dir() || foam {
        return Ok(());
    }
    let entries = std::fs::read_dir(path).into_iter().flatten().flatten().map(|e| e.path());
    let mut meshes: Vec<_> = entries.filter(|p| ends_in(p, &[".stl", ".ply", ".obj", ".vtp", ".vtk", ".vtu", ".msh"])).collect();
    meshes.sort();
    let there = match meshes.first() {
        Some(mesh) => format!("name a mesh in it, such as {}", mesh.display()),
        None => format!("name a mesh: {}", crate::io::mesh::KNOWN),
    };
    let message = format!("{}: is a folder, and no OpenFOAM case: {there}", path.display());
    Err(Failure::new(super::exit::INPUT, anyhow::anyhow!("{message}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_right_command_is_named() {
        for mask in ["a/mask.nrrd", "m.NII.GZ", "wall.stl"] {
            let e = is_case(Path::new(mask)).expect_err("no case").message();
            assert!(e.contains(&format!("lumenmesh mesh {mask}")), "{e}");
        }
        assert!(is_case(Path::new("case.yaml")).is_ok() && is_case(Path::new("case")).is_ok());
        let e = is_input(Path::new("case.yml"), "mesh").expect_err("no input").message();
        assert!(e.contains("lumenmesh run case.yml"), "{e}");
        let dir = tempfile::tempdir().expect("folder");
        assert!(is_mesh(dir.path()).expect_err("empty").message().contains(".vtu"));
        std::fs::write(dir.path().join("wall.stl"), "").expect("write");
        assert!(is_mesh(dir.path()).expect_err("no case").message().contains("wall.stl"));
        std::fs::create_dir(dir.path().join("constant")).expect("folder");
        assert!(is_mesh(dir.path()).is_ok());
    }
}
