//! OpenFOAM: the mesh (`constant/polyMesh`) and a complete case around it. Metres and seconds throughout.

mod case;
mod poly_mesh;

pub use case::write_case;
pub use poly_mesh::write_poly_mesh;

/// The head of a file.
pub(crate) fn header(class: &str, location: &str, object: &str, note: &str) -> String {
    let note = if note.is_empty() { String::new() } else { format!("    note        \"{note}\";\n") };
    format!(
        "FoamFile\n{{\n    version     2.0;\n    format      ascii;\n    class       {class};\n{note}    location    \"{location}\";\n    object      {object};\n}}\n\n"
    )
}
