//! Raw binding to TetGen 1.5.
