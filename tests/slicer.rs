//! The module for 3D Slicer, called as Slicer calls it.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use quick_xml::Reader;
use quick_xml::events::Event;

fn module(args: &[&str], dir: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lumenmesh-slicer")).args(args).current_dir(dir).output().expect("the module starts")
}

/// An element with its attributes, children and text.
#[derive(Debug, Default)]
struct Element {
    name: String,
    attributes: Vec<(String, String)>,
    children: Vec<Element>,
    text: String,
}

impl Element {
    fn child(&self, name: &str) -> Option<&str> {
        self.children.iter().find(|c| c.name == name).map(|c| c.text.as_str())
    }
}

fn parse(xml: &str) -> Element {
    let mut reader = Reader::from_str(xml);
    let mut stack = vec![Element::default()];
    loop {
        match reader.read_event().expect("well-formed XML") {
            Event::Start(e) => {
                let attributes = e.attributes().map(|a| a.expect("an attribute")).map(|a| {
                    (String::from_utf8_lossy(a.key.as_ref()).into_owned(), String::from_utf8_lossy(&a.value).into_owned())
                });
                stack.push(Element {
                    name: String::from_utf8_lossy(e.name().as_ref()).into_owned(),
                    attributes: attributes.collect(),
                    ..Element::default()
                });
            }
            Event::Text(t) => stack.last_mut().expect("open").text.push_str(t.unescape().expect("text").trim()),
            Event::CData(t) => stack.last_mut().expect("open").text.push_str(&String::from_utf8_lossy(&t)),
            Event::End(_) => {
                let done = stack.pop().expect("open");
                stack.last_mut().expect("root").children.push(done);
            }
            Event::Eof => return stack.pop().and_then(|mut r| r.children.pop()).expect("a root"),
            _ => {}
        }
    }
}

/// The module's description, read within Slicer's limit of five seconds and with nothing on standard error.
fn description() -> Element {
    let start = Instant::now();
    let out = module(&["--xml"], Path::new("."));
    assert!(start.elapsed() < Duration::from_secs(5));
    assert!(out.status.success() && out.stderr.is_empty(), "{}", String::from_utf8_lossy(&out.stderr));
    let text = String::from_utf8(out.stdout).expect("UTF-8");
    assert!(text.starts_with("<?xml"), "{text}");
    parse(&text)
}

/// The tags of a parameter in ModuleDescription.xsd and in Slicer's own parser (`channel` of scalars).
const TYPES: [&str; 14] = [
    "integer", "double", "float", "boolean", "string", "integer-vector", "double-vector", "string-enumeration", "file", "directory",
    "image", "geometry", "table", "transform",
];

#[test]
fn the_description_follows_the_published_schema() {
    let root = description();
    assert_eq!(root.name, "executable");
    let order: Vec<&str> = root.children.iter().map(|c| c.name.as_str()).collect();
    let head = ["category", "title", "description", "version", "documentation-url", "license", "contributor"];
    assert_eq!(order[..head.len()], head);
    assert!(order.len() > head.len() && order[head.len()..].iter().all(|n| *n == "parameters"));
    assert_eq!(root.child("version"), Some(env!("CARGO_PKG_VERSION")));
    let (mut names, mut indices) = (vec![], vec![]);
    for group in root.children.iter().filter(|c| c.name == "parameters") {
        assert!(group.attributes.iter().all(|(k, v)| k == "advanced" && (v == "true" || v == "false")));
        assert!(group.child("label").is_some() && group.child("description").is_some());
        for p in group.children.iter().filter(|c| c.name != "label" && c.name != "description") {
            assert!(TYPES.contains(&p.name.as_str()), "{} is no parameter type", p.name);
            let name = p.child("name").expect("a name");
            assert!(name.chars().all(|c| c.is_ascii_alphanumeric()), "{name} is no C++ identifier");
            for c in &p.children {
                let known = ["name", "flag", "longflag", "index", "label", "description", "default", "channel", "constraints", "element"];
                assert!(known.contains(&c.name.as_str()), "{name}: {}", c.name);
                if c.name == "constraints" {
                    let bounds: Vec<f64> = c.children.iter().map(|b| b.text.parse().expect("a number")).collect();
                    assert_eq!(c.children.iter().map(|b| b.name.as_str()).collect::<Vec<_>>(), ["minimum", "maximum", "step"]);
                    let default: f64 = p.child("default").expect("a default").parse().expect("a number");
                    assert!(bounds[0] <= default && default <= bounds[1], "{name}");
                }
            }
            for (key, value) in &p.attributes {
                match key.as_str() {
                    "type" => assert!(["label", "model"].contains(&value.as_str()), "{name}: {value}"),
                    "fileExtensions" => assert!(value.split(',').all(|e| e.starts_with('.')), "{name}: {value}"),
                    other => panic!("{name}: attribute {other}"),
                }
            }
            let (flag, index) = (p.child("longflag"), p.child("index"));
            let scalar_result = flag.is_none() && index.is_none();
            assert!(flag.is_none() || index.is_none(), "{name} has both a flag and an index");
            assert!(!scalar_result || p.child("channel") == Some("output"), "{name} cannot be given");
            assert!(p.name != "boolean" || p.child("default") == Some("false"), "{name}: a flag that is absent is false");
            indices.extend(index.map(|i| i.parse::<usize>().expect("a number")));
            names.push(name.to_string());
        }
    }
    assert_eq!(indices, [0]);
    names.sort();
    let all = names.len();
    names.dedup();
    assert_eq!(names.len(), all, "two parameters share a name");
}

/// The command line that Slicer builds: every flag with its value first, indexed values last.
fn command_line(values: &[(&str, &str)], mask: &str) -> Vec<String> {
    let root = description();
    let mut args = vec![];
    for p in root.children.iter().filter(|c| c.name == "parameters").flat_map(|g| &g.children) {
        let Some(flag) = p.child("longflag") else { continue };
        let given = values.iter().find(|(n, _)| Some(*n) == p.child("name")).map(|v| v.1);
        match (p.name.as_str(), given.or(p.child("default"))) {
            ("boolean", Some("true")) => args.push(flag.to_string()),
            ("boolean", _) | (_, None) => {}
            (_, Some(value)) => args.extend([flag.to_string(), value.to_string()]),
        }
    }
    args.push(mask.into());
    args
}

#[test]
fn slicer_gets_a_model_progress_and_results() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let dir = dir.path();
    let made = Command::new(env!("CARGO_BIN_EXE_lumenmesh")).args(["phantom", "tube", "-o", "case"]).current_dir(dir).output().expect("starts");
    assert!(made.status.success());
    let mut args = vec!["--returnparameterfile".to_string(), "results.params".into(), "--processinformationaddress".into(), "0".into()];
    args.extend(command_line(&[("surface", "model.vtp"), ("volume", "mesh.vtu"), ("scale", "2"), ("folder", "all")], "case/mask.nrrd"));
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let out = module(&args, dir);
    let text = String::from_utf8(out.stdout).expect("UTF-8");
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    assert!(out.stderr.is_empty(), "Slicer shows this as an error: {}", String::from_utf8_lossy(&out.stderr));
    let lines: Vec<&str> = text.lines().collect();
    assert!(lines[0].starts_with("<filter-start><filter-name>lumenmesh</filter-name>"), "{text}");
    assert!(lines.last().is_some_and(|l| l.starts_with("<filter-end><filter-name>lumenmesh</filter-name><filter-time>")), "{text}");
    let progress: Vec<f64> =
        lines.iter().filter_map(|l| l.strip_prefix("<filter-progress>")?.strip_suffix("</filter-progress>")?.parse().ok()).collect();
    assert!(progress.len() > 8 && progress.windows(2).all(|w| w[0] <= w[1]), "{progress:?}");
    assert_eq!(progress.last(), Some(&1.0));
    let results = fs::read_to_string(dir.join("results.params")).expect("results");
    assert!(results.lines().all(|l| l.split_once(" = ").is_some_and(|(k, v)| !k.is_empty() && !v.is_empty())), "{results}");
    let value = |key: &str| results.lines().find_map(|l| l.strip_prefix(&format!("{key} = "))).unwrap_or_else(|| panic!("{key} in {results}"));
    assert_eq!(value("verdict"), "all hard gates are met");
    assert!(value("worstSkewness").parse::<f64>().is_ok_and(|s| s > 0.0 && s < 0.75));
    assert!(value("cells").parse::<u64>().is_ok_and(|n| n > 1000));
    assert!(dir.join(value("report")).is_file());
    // The files that Slicer asked for are those of the results.
    for (copy, original) in [("model.vtp", "surface/lumen.vtp"), ("mesh.vtu", "volume/lumen.vtu")] {
        assert!(fs::read(dir.join(copy)).expect(copy) == fs::read(dir.join("all/lumenmesh").join(original)).expect(original));
    }
}

#[test]
fn slicer_is_told_why_a_run_failed() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let out = module(&["--surface", "model.vtp", "none.nrrd"], dir.path());
    assert_eq!(out.status.code(), Some(3));
    let message = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(message.contains("none.nrrd") && message.contains("check the path"), "{message}");
    assert_eq!(fs::read_dir(dir.path()).expect("list").count(), 0);
}
