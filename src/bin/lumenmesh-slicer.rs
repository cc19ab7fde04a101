//! lumenmesh as a command line module of 3D Slicer.

fn main() -> std::process::ExitCode {
    lumenmesh::cli::slicer::main()
}
