use std::io::Write;
use std::path::PathBuf;

use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use nalgebra::{Matrix3, Rotation3};

use super::*;
use crate::geometry::{Point, Vector};
use crate::io::nrrd::write_mask;
use crate::mask::Mask;

/// A folder for the files of one test.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Folder {
        Folder(tempfile::tempdir().expect("temporary folder"))
    }

    fn write(&self, name: &str, parts: &[&[u8]]) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, parts.concat()).expect("write");
        path
    }

    fn read(&self, name: &str, parts: &[&[u8]]) -> Image {
        read(self.write(name, parts)).expect(name)
    }

    fn error(&self, name: &str, parts: &[&[u8]]) -> String {
        read(self.write(name, parts)).expect_err(name).to_string()
    }
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = GzEncoder::new(Vec::new(), Compression::default());
    out.write_all(bytes).expect("gzip");
    out.finish().expect("gzip")
}

fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut out = ZlibEncoder::new(Vec::new(), Compression::default());
    out.write_all(bytes).expect("zlib");
    out.finish().expect("zlib")
}

/// World position of voxel (1, 2, 3).
fn corner(image: &Image) -> Point {
    image.grid.to_world(Vector::new(1.0, 2.0, 3.0))
}

const NRRD: &str = "NRRD0004\ntype: uint8\ndimension: 3\nspace: left-posterior-superior\nsizes: 2 3 4\nspace directions: (0,0.5,0) (0.5,0,0) (0,0,2)\nspace origin: (10,20,30)\nencoding: raw\n\n";

fn voxels() -> Vec<u8> {
    (0..24).collect()
}

#[test]
fn nrrd_directions_may_be_left_handed_and_ras_becomes_lps() {
    let folder = Folder::new();
    let image = folder.read("a.nrrd", &[NRRD.as_bytes(), &voxels()]);
    assert_eq!(image.values, Values::U8(voxels()));
    assert!(image.grid.is_left_handed());
    assert_eq!(corner(&image), Point::new(11.0, 20.5, 36.0));
    let ras = NRRD.replace("left-posterior-superior", "right-anterior-superior");
    assert_eq!(corner(&folder.read("b.nrrd", &[ras.as_bytes(), &voxels()])), Point::new(-11.0, -20.5, 36.0));
    let las = NRRD.replace("left-posterior-superior", "LAS");
    assert_eq!(corner(&folder.read("c.nrrd", &[las.as_bytes(), &voxels()])), Point::new(11.0, -20.5, 36.0));
    let metres = NRRD.replace("encoding", "space units: \"m\" \"m\" \"m\"\nencoding");
    let image = folder.read("d.nrrd", &[metres.as_bytes(), &voxels()]);
    assert_eq!(image.stated_unit, Some(LengthUnit::Metre));
    approx::assert_relative_eq!(corner(&image), Point::new(11000.0, 20500.0, 36000.0), epsilon = 1e-9);
    // One channel in front of the three axes.
    let channel = NRRD.replace("dimension: 3", "dimension: 4").replace("sizes: ", "sizes: 1 ").replace("directions: ", "directions: none ");
    assert_eq!(corner(&folder.read("e.nrrd", &[channel.as_bytes(), &voxels()])), Point::new(11.0, 20.5, 36.0));
}

#[test]
fn nrrd_data_may_be_packed_written_out_or_kept_in_another_file() {
    let folder = Folder::new();
    let expected = Values::U8(voxels());
    let with = |encoding: &str| NRRD.replace("encoding: raw", &format!("encoding: {encoding}"));
    assert_eq!(folder.read("gz.nrrd", &[with("gzip").as_bytes(), &gzip(&voxels())]).values, expected);
    let mut bz = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::default());
    bz.write_all(&voxels()).expect("bzip2");
    assert_eq!(folder.read("bz.nrrd", &[with("bzip2").as_bytes(), &bz.finish().expect("bzip2")]).values, expected);
    let text: String = voxels().iter().map(|v| format!("{v}\n")).collect();
    assert_eq!(folder.read("txt.nrrd", &[with("ascii").as_bytes(), text.as_bytes()]).values, expected);
    let hex: String = voxels().iter().map(|v| format!("{v:02x} ")).collect();
    assert_eq!(folder.read("hex.nrrd", &[with("hex").as_bytes(), hex.as_bytes()]).values, expected);
    folder.write("voxels.raw", &[b"one line to skip\n", b"xyz", &voxels()]);
    let detached = NRRD.replace("\n\n", "\ndata file: voxels.raw\nline skip: 1\nbyte skip: 3\n");
    assert_eq!(folder.read("d.nhdr", &[detached.as_bytes()]).values, expected);
    let from_end = NRRD.replace("\n\n", "\ndata file: voxels.raw\nbyte skip: -1\n");
    assert_eq!(folder.read("e.nhdr", &[from_end.as_bytes()]).values, expected);
    let skipped = NRRD.replace("\n\n", "\nbyte skip: 5\n\n");
    assert_eq!(folder.read("s.nrrd", &[skipped.as_bytes(), b"12345", &voxels()]).values, expected);
}

#[test]
fn every_scalar_type_is_read_in_both_byte_orders() {
    let folder = Folder::new();
    macro_rules! check {
        ($($name:literal, $variant:ident, $t:ty);* $(;)?) => {$(
            let numbers: Vec<$t> = (0..24).map(|n| (n * 5) as $t).collect();
            for order in ["little", "big"] {
                let bytes: Vec<u8> = numbers.iter().flat_map(|x| if order == "big" { x.to_be_bytes().to_vec() } else { x.to_le_bytes().to_vec() }).collect();
                let header = NRRD.replace("type: uint8", concat!("type: ", $name)).replace("encoding", &format!("endian: {order}\nencoding"));
                assert_eq!(folder.read("t.nrrd", &[header.as_bytes(), &bytes]).values, Values::$variant(numbers.clone()), "{} {order}", $name);
            }
        )*};
    }
    check!("uchar", U8, u8; "int8", I8, i8; "ushort", U16, u16; "short", I16, i16; "uint32", U32, u32; "int", I32, i32;
           "ulonglong", U64, u64; "int64", I64, i64; "float", F32, f32; "double", F64, f64);
}

const MHA: &str = "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\nTransformMatrix = 0 1 0 -1 0 0 0 0 1\nOffset = 10 20 30\nElementSpacing = 0.5 0.25 2\nDimSize = 2 3 4\nElementType = MET_UCHAR\nElementDataFile = LOCAL\n";

#[test]
fn metaimage_rows_of_the_matrix_are_the_axes() {
    let folder = Folder::new();
    let image = folder.read("a.mha", &[MHA.as_bytes(), &voxels()]);
    assert_eq!(corner(&image), Point::new(9.5, 20.5, 36.0));
    let packed = MHA.replace("CompressedData = False", "CompressedData = True");
    assert_eq!(folder.read("z.mha", &[packed.as_bytes(), &zlib(&voxels())]), image);
    folder.write("voxels.raw", &[b"head", &voxels()]);
    let beside = MHA.replace("LOCAL", "voxels.raw").replace("NDims", "HeaderSize = 4\nNDims");
    assert_eq!(folder.read("b.mhd", &[beside.as_bytes()]), image);
    let from_end = MHA.replace("LOCAL", "voxels.raw").replace("NDims", "HeaderSize = -1\nNDims");
    assert_eq!(folder.read("e.mhd", &[from_end.as_bytes()]), image);
    let big = MHA.replace("OrderMSB = False", "OrderMSB = True").replace("MET_UCHAR", "MET_SHORT");
    let bytes: Vec<u8> = (0..24i16).flat_map(|v| (v - 7).to_be_bytes()).collect();
    assert_eq!(folder.read("s.mha", &[big.as_bytes(), &bytes]).values, Values::I16((0..24).map(|v| v - 7).collect()));
}

/// A NIfTI-1 header of 2×3×4 bytes in little endian, to be changed by offset.
fn nifti1(change: impl Fn(&mut dyn FnMut(usize, &[u8]))) -> Vec<u8> {
    let mut h = vec![0u8; 352];
    let mut put = |at: usize, bytes: &[u8]| h[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &348i32.to_le_bytes());
    for (n, d) in [3i16, 2, 3, 4, 1, 1, 1, 1].into_iter().enumerate() {
        put(40 + 2 * n, &d.to_le_bytes());
    }
    put(70, &2i16.to_le_bytes());
    put(72, &8i16.to_le_bytes());
    for (n, d) in [1.0f32, 0.5, 0.25, 2.0].into_iter().enumerate() {
        put(76 + 4 * n, &d.to_le_bytes());
    }
    put(108, &352f32.to_le_bytes());
    put(123, &[2]);
    put(344, b"n+1\0");
    change(&mut put);
    h
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

#[test]
fn nifti_is_placed_by_sform_then_qform_and_turned_to_lps() {
    let folder = Folder::new();
    // A quarter turn about z: (b, c, d) = (0, 0, sin 45°).
    let quarter = std::f32::consts::FRAC_1_SQRT_2;
    let qform = nifti1(|put| {
        put(252, &1i16.to_le_bytes());
        put(256, &floats(&[0.0, 0.0, quarter, 10.0, 20.0, 30.0]));
    });
    let image = folder.read("q.nii", &[&qform, &voxels()]);
    // RAS: x' = 10 − 0.25·2, y' = 20 + 0.5·1, z' = 30 + 2·3.
    approx::assert_relative_eq!(corner(&image), Point::new(-9.5, -20.5, 36.0), epsilon = 1e-6);
    let mirrored = nifti1(|put| {
        put(76, &floats(&[-1.0]));
        put(252, &1i16.to_le_bytes());
        put(256, &floats(&[0.0, 0.0, quarter, 10.0, 20.0, 30.0]));
    });
    let image = folder.read("m.nii.gz", &[&gzip(&[mirrored, voxels()].concat())]);
    approx::assert_relative_eq!(corner(&image), Point::new(-9.5, -20.5, 24.0), epsilon = 1e-6);
    assert_eq!(image.values, Values::U8(voxels()));
    let both = |sheared: bool| {
        nifti1(|put| {
            put(252, &1i16.to_le_bytes());
            put(254, &1i16.to_le_bytes());
            put(256, &floats(&[0.0, 0.0, quarter, 10.0, 20.0, 30.0]));
            put(280, &floats(&[0.0, if sheared { 0.3 } else { 0.0 }, -2.0, 1.0, 0.5, 0.0, 0.0, 2.0, 0.0, 0.25, 0.0, 3.0]));
        })
    };
    let image = folder.read("s.nii", &[&both(false), &voxels()]);
    approx::assert_relative_eq!(corner(&image), Point::new(5.0, -2.5, 3.5), epsilon = 1e-6);
    let image = folder.read("h.nii", &[&both(true), &voxels()]);
    approx::assert_relative_eq!(corner(&image), Point::new(-9.5, -20.5, 36.0), epsilon = 1e-6);
}

#[test]
fn nifti_units_scaling_and_version_2_count() {
    let folder = Folder::new();
    let metres = nifti1(|put| put(123, &[1]));
    assert_eq!(folder.read("m.nii", &[&metres, &voxels()]).grid.spacing(), [500.0, 250.0, 2000.0]);
    let microns = nifti1(|put| put(123, &[3]));
    approx::assert_relative_eq!(folder.read("u.nii", &[&microns, &voxels()]).grid.spacing()[0], 5e-4, epsilon = 1e-12);
    let scaled = nifti1(|put| put(112, &floats(&[2.0, -1.0])));
    let expected: Vec<f64> = voxels().iter().map(|&v| 2.0 * f64::from(v) - 1.0).collect();
    assert_eq!(folder.read("s.nii", &[&scaled, &voxels()]).values, Values::F64(expected));

    let mut two = vec![0u8; 544];
    let mut put = |at: usize, bytes: &[u8]| two[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &540i32.to_be_bytes());
    put(12, &4i16.to_be_bytes());
    for (n, d) in [3i64, 2, 3, 4].into_iter().enumerate() {
        put(16 + 8 * n, &d.to_be_bytes());
    }
    put(168, &544i64.to_be_bytes());
    put(348, &1i32.to_be_bytes());
    for (n, v) in [0.5f64, 0.0, 0.0, 1.0, 0.0, 0.5, 0.0, 2.0, 0.0, 0.0, 3.0, 5.0].into_iter().enumerate() {
        put(400 + 8 * n, &v.to_be_bytes());
    }
    let bytes: Vec<u8> = (0..24i16).flat_map(i16::to_be_bytes).collect();
    let image = folder.read("2.nii", &[&two, &bytes]);
    assert_eq!(image.values, Values::I16((0..24).collect()));
    approx::assert_relative_eq!(corner(&image), Point::new(-1.5, -3.0, 14.0), epsilon = 1e-12);
}

fn vti(array: &str, rest: &str) -> String {
    format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt32\">\n<ImageData WholeExtent=\"1 2 0 2 0 3\" Origin=\"9.5 20 30\" Spacing=\"0.5 0.25 2\" Direction=\"0 -1 0 1 0 0 0 0 1\">\n<Piece Extent=\"1 2 0 2 0 3\"><PointData Scalars=\"m\"><DataArray Name=\"other\" type=\"Float32\" NumberOfComponents=\"3\" format=\"ascii\">1 2 3</DataArray>{array}</PointData></Piece></ImageData>{rest}</VTKFile>\n"
    )
}

#[test]
fn vti_arrays_may_be_text_base64_or_appended() {
    let folder = Folder::new();
    let text: String = voxels().iter().map(|v| format!("{v} ")).collect();
    let image = folder.read("a.vti", &[vti(&format!("<DataArray Name=\"m\" type=\"UInt8\" format=\"ascii\">{text}</DataArray>"), "").as_bytes()]);
    assert_eq!(image.values, Values::U8(voxels()));
    approx::assert_relative_eq!(corner(&image), Point::new(9.0, 21.0, 36.0), epsilon = 1e-12);
    let appended = vti("<DataArray Name=\"m\" type=\"UInt8\" format=\"appended\" offset=\"3\"/>", "<AppendedData encoding=\"raw\">_");
    let appended = appended.trim_end_matches("</VTKFile>\n").to_owned();
    assert_eq!(folder.read("r.vti", &[appended.as_bytes(), b"abc", &24u32.to_le_bytes(), &voxels(), b"</AppendedData>"]), image);
    let inline = vti("<DataArray Name=\"m\" type=\"UInt8\" format=\"binary\">\n GAAAAAABAgMEBQYHCAkKCwwNDg8QERITFBUWFw==\n</DataArray>", "");
    assert_eq!(folder.read("b.vti", &[inline.as_bytes()]), image);
    let packed = zlib(&voxels());
    let header: Vec<u8> = [1u32, 24, 0, packed.len() as u32].into_iter().flat_map(u32::to_le_bytes).collect();
    let appended = appended.replace("header_type", "compressor=\"vtkZLibDataCompressor\" header_type");
    assert_eq!(folder.read("z.vti", &[appended.as_bytes(), b"abc", &header, &packed]), image);
}

#[test]
fn a_written_mask_reads_back_with_its_oblique_place() {
    let folder = Folder::new();
    let direction = Rotation3::from_euler_angles(0.5, -0.2, 1.3).into_inner() * Matrix3::from_diagonal(&Vector::new(1.0, -1.0, 1.0));
    let grid = Grid::new([5, 4, 3], [0.3, 0.4, 1.7], Point::new(-1.25, 1e-3, 712.0), direction).expect("grid");
    let mask = Mask::new(grid, (0..60).map(|n| u8::from(n % 7 < 3)).collect());
    let path = folder.0.path().join("mask.nrrd");
    write_mask(&path, &mask).expect("writes");
    let image = read(&path).expect("reads");
    assert_eq!(image.values, Values::U8(mask.data.clone()));
    approx::assert_relative_eq!(image.grid.axes, mask.grid.axes, epsilon = 1e-14);
    assert_eq!(image.grid.origin, mask.grid.origin);
    let first = std::fs::read(&path).expect("bytes");
    write_mask(&path, &mask).expect("writes");
    assert_eq!(std::fs::read(&path).expect("bytes"), first);
}

#[test]
fn bad_files_are_refused_with_the_file_the_fault_and_the_way_out() {
    let folder = Folder::new();
    let all = |e: &str, words: &[&str]| words.iter().for_each(|w| assert!(e.contains(w), "\"{w}\" is missing in: {e}"));
    let missing = read(folder.0.path().join("absent.nrrd")).expect_err("missing").to_string();
    all(&missing, &["cannot be read", "absent.nrrd", "no such file"]);
    all(&folder.error("x.png", &[b"PNG"]), &["x.png", "format", ".nrrd", ".nii.gz"]);
    all(&folder.error("e.nrrd", &[]), &["e.nrrd", "NRRD0"]);
    all(&folder.error("t.nrrd", &[NRRD.as_bytes(), &voxels()[..20]]), &["24 bytes", "20", "again"]);
    let packed = NRRD.replace("raw", "gzip");
    let stream = gzip(&voxels());
    all(&folder.error("g.nrrd", &[packed.as_bytes(), &stream[..stream.len() - 12]]), &["g.nrrd", "end early", "again"]);
    let mut flipped = stream.clone();
    let last = flipped.len() - 6;
    flipped[last] ^= 1;
    all(&folder.error("c.nrrd", &[packed.as_bytes(), &flipped]), &["damaged", "again"]);
    let huge = NRRD.replace("2 3 4", "100000 100000 100000");
    all(&folder.error("h.nrrd", &[huge.as_bytes(), &voxels()]), &["1000000000000000 bytes", "again"]);
    let endless = NRRD.replace("2 3 4", "18446744073709551615 18446744073709551615 4");
    all(&folder.error("i.nrrd", &[endless.as_bytes(), &voxels()]), &["dimensions"]);
    all(&folder.error("n.nrrd", &[NRRD.replace("(0,0,2)", "(0,0,nan)").as_bytes(), &voxels()]), &["n.nrrd", "spacing", "header"]);
    all(&folder.error("z.nrrd", &[NRRD.replace("(0,0,2)", "(0,0,0)").as_bytes(), &voxels()]), &["spacing"]);
    all(&folder.error("s.nrrd", &[NRRD.replace("(0,0,2)", "(0,1,2)").as_bytes(), &voxels()]), &["direction", "resample"]);
    all(&folder.error("l.nrrd", &[NRRD.replace("sizes: 2 3 4\n", "").as_bytes()]), &["lacks", "sizes"]);
    all(&folder.error("v.nrrd", &[NRRD.replace("uint8", "block").as_bytes()]), &["block", "not supported"]);
    all(&folder.error("a.mha", &[MHA.replace("DimSize = 2 3 4", "DimSize = 2 3").as_bytes()]), &["DimSize = 2 3", "3 numbers"]);
    all(&folder.error("b.mhd", &[MHA.replace("LOCAL", "gone.raw").as_bytes()]), &["b.mhd", "gone.raw", "cannot be read", "header"]);
    all(&folder.error("c.mha", &[MHA.replace("0.5 0.25 2", "0.5 -0.25 2").as_bytes(), &voxels()]), &["spacing", "-0.25"]);
    all(&folder.error("s.nii", &[&[1, 2, 3]]), &["header", "again"]);
    all(&folder.error("n.nii", &[&[7; 400]]), &["NIfTI header"]);
    let time = nifti1(|put| put(40, &[4, 0, 2, 0, 3, 0, 4, 0, 9, 0]));
    all(&folder.error("f.nii", &[&time, &voxels()]), &["[2, 3, 4, 9]", "three axes"]);
    let cut = gzip(&[nifti1(|_| ()), voxels()].concat());
    all(&folder.error("t.nii.gz", &[&cut[..cut.len() - 10]]), &["t.nii.gz", "end early"]);
    all(&folder.error("p.vti", &[vti("", "").as_bytes()]), &["no array"]);
    std::fs::create_dir(folder.0.path().join("d.nrrd")).expect("folder");
    all(&read(folder.0.path().join("d.nrrd")).expect_err("folder").to_string(), &["d.nrrd", "folder"]);
}

#[test]
fn segments_and_their_layers_are_read() {
    let folder = Folder::new();
    let head = |first: bool| {
        let (sizes, directions) = if first { ("2 2 3 4", "none (0,0.5,0) (0.25,0,0) (0,0,2)") } else { ("2 3 4 2", "(0,0.5,0) (0.25,0,0) (0,0,2) none") };
        format!("NRRD0004\ntype: uint8\ndimension: 4\nspace: left-posterior-superior\nsizes: {sizes}\nspace directions: {directions}\nspace origin: (10,20,30)\nencoding: raw\nSegment0_ID:=Segment_1\nSegment0_Name:=Vessel: left\nSegment0_LabelValue:=3\nSegment0_Layer:=0\nSegment1_Name:=Aneurysm\nSegment1_LabelValue:=1\nSegment1_Layer:=1\n\n")
    };
    let other: Vec<u8> = voxels().iter().map(|v| v + 100).collect();
    let woven: Vec<u8> = voxels().into_iter().zip(other.clone()).flat_map(|(a, b)| [a, b]).collect();
    let image = folder.read("a.seg.nrrd", &[head(true).as_bytes(), &woven]);
    assert_eq!((&image.values, image.layers.as_slice()), (&Values::U8(voxels()), &[Values::U8(other.clone())][..]));
    let found: Vec<_> = image.segments.iter().map(|s| (s.name.as_str(), s.label, s.layer)).collect();
    assert_eq!(found, [("Vessel: left", 3, 0), ("Aneurysm", 1, 1)]);
    assert_eq!(folder.read("b.seg.nrrd", &[head(false).as_bytes(), &voxels(), &other]), image);
}

#[test]
fn a_nifti_header_that_contradicts_itself_is_told_or_refused() {
    let folder = Folder::new();
    let sform = |x: f32, y: f32, z: f32, change: &dyn Fn(&mut dyn FnMut(usize, &[u8]))| {
        nifti1(|put| {
            put(254, &1i16.to_le_bytes());
            put(280, &floats(&[-x, 0.0, 0.0, 5.0, 0.0, -y, 0.0, 6.0, 0.0, 0.0, z, 7.0]));
            change(put);
        })
    };
    let sound = folder.read("a.nii", &[&sform(0.5, 0.25, 2.0, &|_| ()), &voxels()]);
    assert!(sound.doubts.is_empty(), "{:?}", sound.doubts);
    let unit = folder.read("b.nii", &[&sform(1.0, 1.0, 1.0, &|_| ()), &voxels()]);
    assert_eq!(unit.grid.spacing(), [0.5, 0.25, 2.0]);
    assert!(unit.doubts[0].contains("0.5 x 0.25 x 2 of the header's pixdim are taken"), "{:?}", unit.doubts);
    let unset = folder.read("c.nii", &[&sform(0.5, 0.25, 2.0, &|put| put(80, &floats(&[1.0, 1.0, 1.0]))), &voxels()]);
    assert_eq!((unset.grid.spacing(), unset.doubts.len()), ([0.5, 0.25, 2.0], 1));
    let e = folder.error("d.nii", &[&sform(0.5, 0.25, 3.0, &|_| ()), &voxels()]);
    assert!(e.contains("0.5 x 0.25 x 3") && e.contains("0.5 x 0.25 x 2") && e.contains("write the image again"), "{e}");
    let moved = sform(0.5, 0.25, 2.0, &|put| {
        put(252, &1i16.to_le_bytes());
        put(256, &floats(&[0.0, 0.0, 1.0, 50.0, 6.0, 7.0]));
    });
    let moved = folder.read("e.nii", &[&moved, &voxels()]);
    assert_eq!((&moved.grid, moved.doubts.len()), (&sound.grid, 1));
}
