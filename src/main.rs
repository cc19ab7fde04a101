//! The `lumenmesh` command.
fn main() {
    if std::env::args_os().nth(1).is_some_and(|a| a == lumenmesh::volume::worker::ARGUMENT) {
        std::process::exit(lumenmesh::volume::worker::serve());
    }
    println!("lumenmesh");
}
