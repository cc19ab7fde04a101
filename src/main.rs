//! The `lumenmesh` command.
fn main() {
    println!("lumenmesh");
}
