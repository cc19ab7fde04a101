//! Damaged files of every format that is read: never a panic, never much memory, and a sentence in every refusal.
//!
//! A quick run damages each sound file a few hundred times; `validation/fuzz/run.sh` asks for 100 000 through
//! `LUMENMESH_FUZZ_CASES` and prints the figures.

use std::fs;
use std::io::Write;
use std::path::Path;

use lumenmesh::config;
use lumenmesh::io::mesh::AnyMesh;
use lumenmesh::io::{fluent, gmsh, image, mesh, openfoam, ply, stl, vtp, vtu};
use lumenmesh::mesh::faces::FaceList;
use lumenmesh::mesh::{TriMesh, VolumeMesh, intersect, topology};
use lumenmesh::phantom::Random;
use lumenmesh::quality;

#[path = "common/tube.rs"]
mod tube;

fn cases() -> usize {
    std::env::var("LUMENMESH_FUZZ_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(200)
}

/// Numbers that headers should not hold.
const NASTY: [&str; 12] =
    ["0", "-1", "1", "4294967295", "4294967296", "18446744073709551615", "9223372036854775807", "1e308", "-1e-308", "nan", "inf", "ffffffff"];

/// Changes, cuts, doubles and moves bytes, and puts other numbers in the place of numbers.
fn damage(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut out = bytes.to_vec();
    for _ in 0..1 + random.bits() % 4 {
        if out.is_empty() {
            return out;
        }
        let at = (random.bits() as usize) % out.len();
        match random.bits() % 9 {
            0 => out[at] = random.bits() as u8,
            1 => out[at] = b"0123456789-.()\n :=<>{}[]\"'#&*!|"[(random.bits() % 31) as usize],
            2 => out[at] ^= 1 << (random.bits() % 8),
            3 => out.truncate(at + 1),
            4 => out.insert(at, b'9'),
            5 => {
                out.remove(at);
            }
            6 => {
                let n = (random.bits() as usize % 40).min(out.len() - at);
                let piece = out[at..at + n].to_vec();
                let to = (random.bits() as usize) % (out.len() + 1);
                out.splice(to..to, piece);
            }
            7 => {
                // Four or eight bytes of a binary number.
                let n = [4, 8][(random.bits() % 2) as usize].min(out.len() - at);
                let value = [0u64, 1, u64::MAX, 1 << 31, 1 << 40, 0x7ff8_0000_0000_0000][(random.bits() % 6) as usize];
                out[at..at + n].copy_from_slice(&value.to_le_bytes()[..n]);
            }
            _ => {
                let digit = |b: &u8| b.is_ascii_digit() || matches!(b, b'-' | b'.');
                let Some(start) = out[at..].iter().position(digit).map(|i| at + i) else { continue };
                let end = out[start..].iter().position(|b| !digit(b)).map_or(out.len(), |i| start + i);
                out.splice(start..end, NASTY[(random.bits() % 12) as usize].bytes());
            }
        }
    }
    out
}

/// Resident memory of this process, its highest so far, in bytes; 0 where the system does not tell.
fn peak() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|l| l.starts_with("VmHWM:"));
    line.and_then(|l| l.split_whitespace().nth(1)).and_then(|n| n.parse::<u64>().ok()).unwrap_or(0) * 1024
}

/// Damages `sound` again and again and hands it to `read`, which says whether it was refused, and why.
fn try_all(name: &str, sound: &[u8], mut read: impl FnMut(&[u8]) -> Result<(), String>) {
    read(sound).unwrap_or_else(|e| panic!("{name} is sound: {e}"));
    let mut random = Random::new(name.bytes().fold(7, |h, b| h * 31 % 1_000_003 + u64::from(b)));
    let mut refused = 0;
    for _ in 0..cases() {
        if let Err(e) = read(&damage(sound, &mut random)) {
            refused += 1;
            assert!(e.len() > 15, "{name}: \"{e}\" explains nothing");
        }
    }
    let peak = peak();
    println!("| {name} | {} | {} | {refused} | {} |", sound.len(), cases(), peak / 1_000_000);
    assert!(peak < 1_000_000_000, "{name}: {peak} bytes of memory");
}

fn pack(bytes: &[u8], how: &str) -> Vec<u8> {
    use flate2::{Compression, write};
    let level = Compression::default();
    let done = match how {
        "gzip" => {
            let mut w = write::GzEncoder::new(Vec::new(), level);
            w.write_all(bytes).and_then(|()| w.finish())
        }
        "bzip2" => {
            let mut w = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::default());
            w.write_all(bytes).and_then(|()| w.finish())
        }
        _ => {
            let mut w = write::ZlibEncoder::new(Vec::new(), level);
            w.write_all(bytes).and_then(|()| w.finish())
        }
    };
    done.expect("packs")
}

const NRRD: &str = "NRRD0004\ntype: short\nendian: big\ndimension: 3\nspace: left-posterior-superior\nsizes: 2 3 4\nspace directions: (0,0.5,0) (0.5,0,0) (0,0,2)\nspace origin: (10,20,30)\nencoding: raw\n\n";
const MHA: &str = "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\nTransformMatrix = 0 1 0 -1 0 0 0 0 1\nOffset = 10 20 30\nElementSpacing = 0.5 0.25 2\nDimSize = 2 3 4\nElementType = MET_USHORT\nElementDataFile = LOCAL\n";

/// A NIfTI-1 header of 2 × 3 × 4 voxels of 16 bits with an sform.
fn nifti() -> Vec<u8> {
    let mut h = vec![0u8; 352];
    let mut put = |at: usize, bytes: &[u8]| h[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &348i32.to_le_bytes());
    for (n, d) in [3i16, 2, 3, 4, 1, 1, 1, 1].into_iter().enumerate() {
        put(40 + 2 * n, &d.to_le_bytes());
    }
    put(70, &4i16.to_le_bytes());
    put(72, &16i16.to_le_bytes());
    for (n, d) in [1.0f32, 0.5, 2.0, 3.0].into_iter().enumerate() {
        put(76 + 4 * n, &d.to_le_bytes());
    }
    put(108, &352f32.to_le_bytes());
    put(123, &[2]);
    put(254, &1i16.to_le_bytes());
    for (n, v) in [0.0f32, -2.0, 0.0, 5.0, 0.5, 0.0, 0.0, 2.0, 0.0, 0.0, 3.0, 3.0].into_iter().enumerate() {
        put(280 + 4 * n, &v.to_le_bytes());
    }
    put(344, b"n+1\0");
    h
}

fn vti(root: &str, array: &str, rest: &str) -> String {
    format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt32\"{root}>\n<ImageData WholeExtent=\"1 2 0 2 0 3\" Origin=\"9.5 20 30\" Spacing=\"0.5 0.25 2\" Direction=\"0 -1 0 1 0 0 0 0 1\">\n<Piece Extent=\"1 2 0 2 0 3\"><PointData Scalars=\"m\">{array}</PointData></Piece></ImageData>{rest}"
    )
}

#[test]
fn damaged_masks() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let voxels: Vec<u8> = (0..24u16).flat_map(u16::to_be_bytes).collect();
    let little: Vec<u8> = (0..24u16).flat_map(u16::to_le_bytes).collect();
    let text: String = (0..24).map(|n| format!("{n} ")).collect();
    let read = |name: &'static str| {
        let path = dir.path().join(name);
        move |bytes: &[u8]| {
            fs::write(&path, bytes).expect("write");
            let image = image::read(&path).map_err(|e| e.to_string())?;
            assert_eq!(image.values.len(), image.grid.len(), "{name}");
            Ok(())
        }
    };
    let nrrd = |encoding: &str, body: Vec<u8>| [NRRD.replace("raw", encoding).as_bytes(), &body].concat();
    try_all("NRRD raw", &nrrd("raw", voxels.clone()), read("raw.nrrd"));
    try_all("NRRD gzip", &nrrd("gzip", pack(&voxels, "gzip")), read("gzip.nrrd"));
    try_all("NRRD bzip2", &nrrd("bzip2", pack(&voxels, "bzip2")), read("bzip2.nrrd"));
    try_all("NRRD text", &nrrd("text", text.clone().into_bytes()), read("text.nrrd"));
    try_all("NRRD hex", &nrrd("hex", voxels.iter().flat_map(|b| format!("{b:02x}").into_bytes()).collect()), read("hex.nrrd"));
    fs::write(dir.path().join("voxels.raw"), &voxels).expect("write");
    fs::write(dir.path().join("voxels.zraw"), pack(&little, "zlib")).expect("write");
    try_all("NRRD detached (.nhdr)", NRRD.replace("\n\n", "\ndata file: voxels.raw\nline skip: 0\nbyte skip: 0\n").as_bytes(), read("a.nhdr"));
    try_all("MetaImage (.mha)", &[MHA.as_bytes(), &little].concat(), read("raw.mha"));
    let packed = MHA.replace("CompressedData = False", "CompressedData = True");
    try_all("MetaImage zlib (.mha)", &[packed.as_bytes(), &pack(&little, "zlib")].concat(), read("zlib.mha"));
    try_all("MetaImage with .raw (.mhd)", MHA.replace("LOCAL", "voxels.raw").replace("NDims", "HeaderSize = 0\nNDims").as_bytes(), read("a.mhd"));
    try_all("MetaImage with .zraw (.mhd)", packed.replace("LOCAL", "voxels.zraw").as_bytes(), read("z.mhd"));
    let whole = [nifti(), little.clone()].concat();
    try_all("NIfTI (.nii)", &whole, read("a.nii"));
    try_all("NIfTI gzip (.nii.gz)", &pack(&whole, "gzip"), read("a.nii.gz"));
    let ascii = format!("<DataArray Name=\"m\" type=\"UInt16\" format=\"ascii\">{text}</DataArray>");
    try_all("VTI text", (vti("", &ascii, "") + "</VTKFile>").as_bytes(), read("text.vti"));
    let inline = "<DataArray Name=\"m\" type=\"UInt8\" format=\"binary\">GAAAAAABAgMEBQYHCAkKCwwNDg8QERITFBUWFw==</DataArray>";
    try_all("VTI base64", (vti("", inline, "") + "</VTKFile>").as_bytes(), read("base64.vti"));
    let array = "<DataArray Name=\"m\" type=\"UInt16\" format=\"appended\" offset=\"0\"/>";
    let mark = "<AppendedData encoding=\"raw\">_";
    let appended = [vti("", array, mark).as_bytes(), &48u32.to_le_bytes(), &little].concat();
    try_all("VTI appended", &appended, read("raw.vti"));
    let block = pack(&little, "zlib");
    let head: Vec<u8> = [1u32, 48, 0, block.len() as u32].into_iter().flat_map(u32::to_le_bytes).collect();
    let appended = [vti(" compressor=\"vtkZLibDataCompressor\"", array, mark).as_bytes(), &head, &block].concat();
    try_all("VTI appended zlib", &appended, read("zlib.vti"));
}

/// One tetrahedron in appended raw data, each array one block packed by zlib or LZ4.
fn packed_vtu(compressor: &str) -> Vec<u8> {
    let bytes = |v: &[f64]| v.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let ids = |v: &[i64]| v.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let arrays = [bytes(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]), ids(&[0, 1, 2, 3]), ids(&[4]), vec![10]];
    let (mut data, mut offsets) = (Vec::new(), Vec::new());
    for array in &arrays {
        offsets.push(data.len());
        let block = if compressor.contains("LZ4") { lz4_flex::block::compress(array) } else { pack(array, "zlib") };
        data.extend([1u32, array.len() as u32, 0, block.len() as u32].into_iter().flat_map(u32::to_le_bytes));
        data.extend(block);
    }
    let array = |name: &str, kind: &str, n: usize, at: usize| {
        format!("<DataArray Name=\"{name}\" type=\"{kind}\" NumberOfComponents=\"{n}\" format=\"appended\" offset=\"{}\"/>", offsets[at])
    };
    let head = format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt32\" compressor=\"{compressor}\">\n<UnstructuredGrid><Piece NumberOfPoints=\"4\" NumberOfCells=\"1\"><Points>{}</Points><Cells>{}{}{}</Cells></Piece></UnstructuredGrid>\n<AppendedData encoding=\"raw\">_",
        array("Points", "Float64", 3, 0),
        array("connectivity", "Int64", 1, 1),
        array("offsets", "Int64", 1, 2),
        array("types", "UInt8", 1, 3),
    );
    [head.as_bytes(), &data, b"</AppendedData></VTKFile>\n"].concat()
}

/// What `check` does with a mesh: corners in range, and every measure taken.
fn measured(mesh: AnyMesh, name: &str) -> Result<(), String> {
    match mesh {
        AnyMesh::Surface(s) => {
            assert!(s.triangles.iter().flatten().all(|&v| (v as usize) < s.points.len()), "{name}");
            assert_eq!(s.triangles.len(), s.patch.len(), "{name}");
            let _ = (topology::check(&s), intersect::self_intersections(&s));
            let _ = quality::surface(&s, &Default::default());
        }
        AnyMesh::Volume(v) => {
            assert!(v.tets.iter().flatten().chain(v.prisms.iter().flatten()).all(|&p| (p as usize) < v.points.len()), "{name}");
            quality::volume(&v, &Default::default()).map_err(|e| e.to_string())?;
        }
        AnyMesh::Polyhedral(p) => {
            assert!(p.vertices.iter().all(|&v| (v as usize) < p.points.len()), "{name}");
            let _ = quality::polyhedral(&p, &Default::default());
        }
    }
    Ok(())
}

fn bytes(write: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Vec<u8> {
    let mut out = Vec::new();
    write(&mut out).expect("writes to memory");
    out
}

/// The boundary of a small tube, by patch.
fn surface(volume: &VolumeMesh) -> TriMesh {
    let mut mesh = TriMesh { points: volume.points.clone(), patches: volume.patches.clone(), ..TriMesh::default() };
    for f in &volume.boundary {
        let ids = f.ids();
        for i in 1..ids.len() - 1 {
            mesh.triangles.push([ids[0], ids[i], ids[i + 1]]);
            mesh.patch.push(f.patch);
        }
    }
    mesh
}

/// The surface as a binary legacy file of version 5.
fn legacy_vtk(s: &TriMesh) -> Vec<u8> {
    let (n, m) = (s.points.len(), s.triangles.len());
    let mut out = format!("# vtk DataFile Version 5.1\na surface\nBINARY\nDATASET POLYDATA\nPOINTS {n} float\n").into_bytes();
    s.points.iter().flat_map(|p| [p.x, p.y, p.z]).for_each(|c| out.extend((c as f32).to_be_bytes()));
    out.extend(format!("\nPOLYGONS {} {}\nOFFSETS vtktypeint64\n", m + 1, 3 * m).bytes());
    (0..=m as i64).for_each(|i| out.extend((3 * i).to_be_bytes()));
    out.extend(b"\nCONNECTIVITY vtktypeint64\n");
    s.triangles.iter().flatten().for_each(|&v| out.extend(i64::from(v).to_be_bytes()));
    out.extend(b"\n");
    out
}

fn read_mesh(path: &Path, bytes: &[u8], name: &str) -> Result<(), String> {
    fs::write(path, bytes).expect("write");
    mesh::read(path).map_err(|e| e.to_string()).and_then(|m| measured(m, name))
}

#[test]
fn damaged_meshes() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (volume, prisms) = (tube::tube(1.0, 2.0, 1, 2, false), tube::tube(1.0, 2.0, 2, 1, true));
    let s = surface(&volume);
    let sound = [
        ("STL text", "a.stl", bytes(|w| stl::write(w, &s))),
        ("STL binary", "b.stl", bytes(|w| stl::write_binary(w, &s))),
        ("PLY", "a.ply", bytes(|w| ply::write(w, &s))),
        ("PLY text", "b.ply", b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty double y\nproperty float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0.5\n3 0 1 2\n3 0 2 3\n".to_vec()),
        ("OBJ", "a.obj", b"# a sheet\no sheet\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0.5\nvn 0 0 1\ng lower\nf 1//1 2//1 3//1\ng upper\nf -4 -2 -1\n".to_vec()),
        ("legacy VTK", "a.vtk", b"# vtk DataFile Version 3.0\nsheet\nASCII\nDATASET POLYDATA\nPOINTS 4 float\n0 0 0 1 0 0 1 1 0 0 1 0.5\nPOLYGONS 1 4\n3 0 1 2\nTRIANGLE_STRIPS 1 4\n3 0 2 3\n".to_vec()),
        ("legacy VTK binary", "b.vtk", legacy_vtk(&s)),
        ("VTP", "a.vtp", bytes(|w| vtp::write_surface(w, &s, &vtp::Extra::default()))),
        ("VTU", "a.vtu", bytes(|w| vtu::write(w, &prisms, &vec![0.5; prisms.cell_count()], &vtp::Extra::default()))),
        ("VTU zlib", "zlib.vtu", packed_vtu("vtkZLibDataCompressor")),
        ("VTU LZ4", "lz4.vtu", packed_vtu("vtkLZ4DataCompressor")),
        ("Gmsh", "gmsh.msh", bytes(|w| gmsh::write(w, &volume))),
        ("FLUENT", "fluent.msh", bytes(|w| fluent::write(w, &prisms, &FaceList::build(&prisms).expect("faces")))),
    ];
    for (name, file, sound) in sound {
        let path = dir.path().join(file);
        try_all(name, &sound, |bytes| read_mesh(&path, bytes, name));
    }
}

#[test]
fn damaged_openfoam_meshes() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let volume = tube::tube(1.0, 2.0, 1, 1, false);
    openfoam::write_poly_mesh(dir.path(), &FaceList::build(&volume).expect("faces")).expect("writes");
    for file in ["points", "faces", "owner", "neighbour", "boundary"] {
        let path = dir.path().join("constant/polyMesh").join(file);
        let sound = fs::read(&path).expect("written");
        try_all(&format!("OpenFOAM {file}"), &sound, |bytes| {
            fs::write(&path, bytes).expect("write");
            mesh::read(dir.path()).map_err(|e| e.to_string()).and_then(|m| measured(m, file))
        });
        fs::write(&path, &sound).expect("write");
    }
}

#[test]
fn damaged_case_files() {
    let sound = "# a case\ninput: {mask: a.nrrd, label: [1, 4], cleaning: {max_hole: 27 voxels}}\nsurface:\n  remesher: isotropic\n  edge_length: 0.1 R\n  refine:\n  - {sphere: {center: [1, 2, 3], radius: 4}, edge_length: 0.2 mm}\nopenings:\n- {name: inlet, center: [0, 0.1, 1e-7], normal: [0, 0, 1]}\n- name: outlet_1\n  center: [0, 0, 9]\n  normal: [0, 0, -1]\nvolume: {boundary_layers: {count: 4, total: 0.25 R}, growth: 0.2}\nflow: &f {inlet: {reynolds: 300}, outlets: {split: murray}}\nexports: [vtk, stl, \"openfoam\", 'fluent']\n";
    try_all("case file (YAML)", sound.as_bytes(), |bytes| {
        let Ok(text) = std::str::from_utf8(bytes) else { return Err("the file is not UTF-8".into()) };
        let case = config::from_text(text, "case.yaml", &[]).map_err(|e| e.to_string())?;
        // What is accepted can be written and means the same when read again.
        let yaml = config::to_yaml(&case).map_err(|e| e.to_string())?;
        assert_eq!(config::from_text(&yaml, "resolved", &[]).map_err(|e| format!("{e}\n{yaml}")), Ok(case));
        Ok(())
    });
    let sets = "surface.refine.0.edge_length=0.3 mm";
    try_all("--set", sets.as_bytes(), |bytes| {
        let Ok(set) = std::str::from_utf8(bytes) else { return Err("the text is not UTF-8".into()) };
        config::from_text(sound, "case.yaml", &[set.to_string()]).map(|_| ()).map_err(|e| e.to_string())
    });
}
