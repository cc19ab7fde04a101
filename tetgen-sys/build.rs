//! Compiles the shim against Debian's TetGen 1.5 and links it.

fn main() {
    println!("cargo::rerun-if-changed=src/shim.cpp");
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=TETGEN_INCLUDE_DIR");
    println!("cargo::rerun-if-env-changed=TETGEN_LIB_DIR");
    let include = std::env::var_os("TETGEN_INCLUDE_DIR");
    let mut build = cc::Build::new();
    build.cpp(true).std("c++14").define("TETLIBRARY", None).warnings(false).flag_if_supported("-fexceptions");
    if let Some(dir) = &include {
        build.include(dir);
    }
    let probe = std::path::Path::new(&std::env::var("OUT_DIR").unwrap_or_default()).join("probe.cpp");
    let found = std::fs::write(&probe, "#include <tetgen.h>\n").is_ok()
        && build.clone().cargo_metadata(false).cargo_warnings(false).file(&probe).try_expand().is_ok();
    if !found {
        println!(
            "cargo::error=TetGen's header tetgen.h was not found: install the Debian package libtet1.5-dev \
             (sudo apt-get install libtet1.5-dev), or set TETGEN_INCLUDE_DIR and TETGEN_LIB_DIR to a TetGen 1.5 build"
        );
        return;
    }
    build.file("src/shim.cpp").compile("lumenmesh_tetgen_shim");
    if let Ok(dir) = std::env::var("TETGEN_LIB_DIR") {
        println!("cargo::rustc-link-search=native={dir}");
    }
    println!("cargo::rustc-link-lib=tet");
}
