//! What is shown: pictures against exact silhouettes, and the page of a fit against its report and its files.

#[path = "common/program.rs"]
mod program;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use glam::DVec3;
use program::*;
use serde_json::Value;
use std::path::Path;
use std::sync::OnceLock;
use vorofit::device::Device;
use vorofit::features::{Features, Scale};
use vorofit::files::{SurfaceToWrite, read_surface, write_surface};
use vorofit::mesh::{Frame, PolygonMesh, TriangleMesh, shapes};
use vorofit::picture::{Axis, Paint, Picture, Scene, Shape, Strokes, View, color, edges};
use vorofit::report::Report;
use vorofit::report::feature_layers::{point_layers, ridge_layers};
use vorofit::report::page::{Page, Subject};
use vorofit::topology;

const FRONT: View = View {
    from: DVec3::Z,
    up: DVec3::Y,
};

fn draw(surfaces: &[(&Shape, Paint<'_>)], strokes: Vec<Strokes>, size: [u32; 2]) -> Picture {
    let scene = Scene {
        surfaces: surfaces.to_vec(),
        strokes,
        legend: None,
    };
    Picture::draw(&scene, &FRONT, size)
}

fn moved(mesh: &TriangleMesh, by: DVec3) -> TriangleMesh {
    TriangleMesh {
        positions: mesh.positions.iter().map(|&p| p + by).collect(),
        triangles: mesh.triangles.clone(),
    }
}

/// Whether a pixel is mostly not background.
fn is_drawn(pixel: [u8; 3]) -> bool {
    pixel.iter().any(|&byte| byte < 245)
}

#[test]
fn a_ball_has_a_round_silhouette_that_fills_the_picture() {
    let ball = Shape::smooth(&shapes::sphere(3.0, 5));
    let (width, height) = (360, 240);
    let picture = draw(
        &[(&ball, Paint::Plain(color::TARGET))],
        vec![],
        [width, height],
    );
    assert_eq!(picture.size(), [360, 240]);
    // The margin is 6 % of the shorter side, and a ball in the middle stays a circle in perspective.
    let radius = (0.5 - 0.06) * f64::from(height);
    for (k, &pixel) in picture.pixels().iter().enumerate() {
        let (x, y) = (
            (k % 360) as f64 + 0.5 - 180.0,
            (k / 360) as f64 + 0.5 - 120.0,
        );
        let inside = radius - x.hypot(y);
        if inside.abs() > 1.0 {
            assert_eq!(is_drawn(pixel), inside > 0.0, "{x} {y}: {inside}");
        }
    }
}

#[test]
fn what_is_in_front_hides_what_is_behind() {
    let ball = shapes::sphere(1.0, 4);
    let [near, far] = [1.5, -1.5].map(|z| Shape::smooth(&moved(&ball, DVec3::Z * z)));
    let (red, blue) = (Paint::Plain([200, 0, 0]), Paint::Plain([0, 0, 200]));
    let center = |picture: &Picture| picture.pixels()[100 * 200 + 100];
    for surfaces in [[(&near, red), (&far, blue)], [(&far, blue), (&near, red)]] {
        let pixel = center(&draw(&surfaces, vec![], [200, 200]));
        assert!(pixel[0] > 60 && pixel[2] < 60, "{pixel:?}");
    }
    // A line through both centres' height, in front of, inside and behind the near ball.
    let line = |z: f64| Strokes {
        segments: vec![[DVec3::new(-1.0, 0.0, z), DVec3::new(1.0, 0.0, z)]],
        color: [0, 160, 0],
        width: 6.0,
    };
    let green = |z: f64| {
        let pixel = center(&draw(&[(&near, red)], vec![line(z)], [200, 200]));
        pixel[1] > pixel[0]
    };
    assert_eq!([2.6, 1.5, 0.0].map(green), [true, false, false]);
}

#[test]
fn edges_lie_on_their_faces_and_values_have_their_colours() {
    let cube = shapes::box_grid(-DVec3::ONE, DVec3::ONE, [2, 2, 2]);
    let faces = Shape::faceted(&cube);
    let segments: Vec<_> = edges(&cube)
        .into_iter()
        .map(|edge| edge.map(|v| cube.positions[v as usize]))
        .collect();
    let strokes = Strokes {
        segments,
        color: [0, 0, 0],
        width: 3.0,
    };
    let picture = draw(
        &[(&faces, Paint::Plain([255, 255, 255]))],
        vec![strokes],
        [201, 201],
    );
    let at = |x: usize, y: usize| picture.pixels()[y * 201 + x];
    assert!(
        at(100, 100)[0] < 130,
        "a crossing of edges: {:?}",
        at(100, 100)
    );
    assert!(
        at(125, 125)[0] > 150,
        "the middle of a face: {:?}",
        at(125, 125)
    );

    // A point keeps its colour on a surface, whose light shows the depth; at the far end of a cloud it fades.
    let points = |places: &[DVec3]| Strokes {
        segments: places.iter().map(|&p| [p, p]).collect(),
        color: [255, 150, 0],
        width: 9.0,
    };
    let middle = |surfaces: &[(&Shape, Paint<'_>)], places: &[DVec3]| {
        draw(surfaces, vec![points(places)], [201, 201]).pixels()[100 * 201 + 100]
    };
    let solid = middle(&[(&faces, Paint::Plain([255; 3]))], &[DVec3::Z]);
    assert!(
        solid[0] > 252 && solid[1].abs_diff(150) < 3 && solid[2] < 3,
        "{solid:?}"
    );
    let aside = [DVec3::X, DVec3::NEG_X].map(|p| p + DVec3::Z);
    let far = middle(&[], &[aside[0], aside[1], DVec3::NEG_Z]);
    assert!((50..250).contains(&far[2]), "{far:?}");

    // Unknown is grey, no error is light, the largest is dark and reddish.
    let shade = |value: f64| {
        let values = vec![value; cube.positions.len()];
        draw(&[(&faces, Paint::Values(&values))], vec![], [64, 64]).pixels()[32 * 64 + 32]
    };
    let [unknown, none, half, all, beyond] = [-1.0, 0.0, 0.5, 1.0, 9.0].map(shade);
    let spread = |c: [u8; 3]| c.iter().max().unwrap() - c.iter().min().unwrap();
    assert!(spread(unknown) < 20 && spread(half) > 40);
    assert!(none[1] > half[1] && half[1] > all[1] && all == beyond);
}

#[test]
fn any_number_of_threads_draws_the_same_bits_and_degenerate_scenes_are_drawn() {
    let ball = Shape::smooth(&ball());
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let one = || draw(&[(&ball, Paint::Plain(color::TARGET))], vec![], [150, 130]);
        pool.expect("a pool").install(one)
    };
    assert!(with(1) == with(3));

    let empty = draw(&[], vec![], [1, 1]);
    assert_eq!(empty.pixels(), [[255; 3]]);
    let point = TriangleMesh {
        positions: vec![DVec3::splat(5e6); 3],
        triangles: vec![[0, 1, 2], [0, 0, 0]],
    };
    let point = Shape::smooth(&point);
    assert!(
        !draw(&[(&point, Paint::Plain(color::CAGE))], vec![], [40, 30])
            .pixels()
            .iter()
            .any(|&p| is_drawn(p))
    );
}

/// Width, height and pixels of a PNG file.
fn decoded(bytes: &[u8]) -> (usize, usize, Vec<[u8; 3]>) {
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
        .read_info()
        .expect("a PNG");
    let mut buffer = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut buffer).expect("pixels");
    assert_eq!(info.color_type, png::ColorType::Rgb);
    let pixels = buffer.chunks(3).map(|c| [c[0], c[1], c[2]]).collect();
    (info.width as usize, info.height as usize, pixels)
}

#[test]
fn a_png_holds_the_pixels_that_were_drawn() {
    let ball = Shape::smooth(&ball());
    let picture = draw(&[(&ball, Paint::Plain(color::TARGET))], vec![], [50, 40]);
    let (width, height, pixels) = decoded(&picture.png().expect("a PNG"));
    assert_eq!(
        ([width, height], pixels.as_slice()),
        (picture.size(), picture.pixels())
    );
}

#[test]
fn render_draws_cages_errors_and_distances() {
    let folder = folder_with_scan("render");
    let at = |name: &str| folder.join(name).to_str().expect("UTF-8").to_owned();
    let cage = shapes::box_grid(-DVec3::ONE, DVec3::ONE, [3, 3, 3]);
    write_surface(
        &folder.join("cage.obj"),
        &SurfaceToWrite::dense(&cage, None),
    )
    .expect("written");
    let dense: PolygonMesh = shapes::sphere(1.0, 3).into();
    let error: Vec<f64> = dense.positions.iter().map(|p| 0.01 * (1.0 + p.x)).collect();
    let with_error = SurfaceToWrite::dense(&dense, Some(&error));
    write_surface(&folder.join("error.ply"), &with_error).expect("written");

    let ink = |pixels: &[[u8; 3]]| pixels.iter().filter(|p| p[0] < 110).count();
    let picture = |args: &[&str]| {
        let out = at("picture.png");
        let said = succeed(&[&["render"], args, &["-o", &out, "--size", "320x240"]].concat());
        assert!(said.contains("320 × 240 pixels"), "{said}");
        decoded(&std::fs::read(&out).expect("a picture")).2
    };
    let mesh = at("cage.obj");
    // A face seen from the front is light all over, but for its edges.
    let front = [mesh.as_str(), "--from", "0,0,1"];
    assert!(ink(&picture(&front)) > 100, "edges");
    assert_eq!(
        ink(&picture(&[&front[..], &["--edges", "off"]].concat())),
        0
    );
    // The error grows to the right: dark there, light at the left.
    let sum = |pixels: &[[u8; 3]], columns: std::ops::Range<usize>| -> usize {
        let drawn = pixels
            .iter()
            .enumerate()
            .filter(|(k, p)| columns.contains(&(k % 320)) && is_drawn(**p));
        let bytes: Vec<_> = drawn.map(|(_, p)| usize::from(p[1])).collect();
        bytes.iter().sum::<usize>() / bytes.len()
    };
    let pixels = picture(&[&at("error.ply"), "--edges", "off", "--from", "0,0,1"]);
    assert!(sum(&pixels, 40..80) > sum(&pixels, 160..200) + 50);
    let pixels = picture(&[&at("error.ply"), "--target", &at("scan.ply"), "--up", "z"]);
    assert!(
        pixels.iter().any(|p| p[0] > p[2].saturating_add(60)),
        "colours"
    );

    for (args, status) in [
        (vec!["render", &mesh, "-o", &mesh], 1),
        (vec!["render", &mesh, "-o", "a.jpg"], 1),
        (vec!["render", &mesh, "-o", "a.png", "--size", "0x9"], 2),
        (vec!["render", &mesh, "-o", "a.png", "--from", "0,0,0"], 2),
    ] {
        assert_eq!(run(&args).status.code(), Some(status), "{args:?}");
    }
}

/// A name that would break out of HTML, of a script, of an attribute and of a shell's quotes.
const HOSTILE: &str = "a <b>&\"'{{script}}$(x).ply";

/// The text of the page of a small fit whose scan has a hostile name, and its folder.
fn page() -> &'static (String, std::path::PathBuf) {
    static PAGE: OnceLock<(String, std::path::PathBuf)> = OnceLock::new();
    PAGE.get_or_init(|| {
        let folder = folder("page");
        let mut scan = ball();
        scan.triangles
            .retain(|t| !t.iter().any(|&v| scan.positions[v as usize].x > 1.15));
        write(&folder.join(HOSTILE), &scan);
        let at = |name: &str| folder.join(name).to_str().expect("UTF-8").to_owned();
        let said = succeed(&[
            "fit",
            &at(HOSTILE),
            "-o",
            &at("control.obj"),
            "--surface",
            &at("surface.ply"),
            "--report",
            &at("seen"),
            "--up",
            "z",
            "--json",
            &at("report.json"),
            "--template",
            "bbox",
            "--control-points",
            "98",
            "--device",
            "cpu",
        ]);
        assert!(
            said.lines()
                .last()
                .expect("lines")
                .contains("index.html in any browser"),
            "{said}"
        );
        let page = std::fs::read_to_string(folder.join("seen/index.html")).expect("a page");
        (page, folder)
    })
}

/// The content of a script element of the page.
fn script<'a>(page: &'a str, id: &str) -> &'a str {
    let open = format!("<script type=\"application/json\" id=\"{id}\">");
    let start = page.find(&open).expect("the element") + open.len();
    let length = page[start..].find("</script").expect("its end");
    &page[start..start + length]
}

#[test]
fn the_page_needs_nothing_but_itself_and_its_pictures_are_files_too() {
    let (page, folder) = page();
    let seen = folder.join("seen");
    assert_eq!(
        names(&seen),
        ["cage.png", "index.html", "surface.png", "target.png"]
    );
    for outside in [
        "http:", "https:", "url(", "@import", "import(", "fetch(", "XMLHttp",
    ] {
        assert!(!page.contains(outside), "{outside}");
    }
    for attribute in ["src=\"", "href=\""] {
        for (at, _) in page.match_indices(attribute) {
            assert!(
                page[at + attribute.len()..].starts_with("data:"),
                "{attribute}"
            );
        }
    }
    assert!(page.contains("default-src 'none'"));
    for name in ["target.png", "cage.png", "surface.png"] {
        let bytes = std::fs::read(seen.join(name)).expect(name);
        let (width, height, pixels) = decoded(&bytes);
        assert_eq!((width, height), (1200, 900));
        let drawn = pixels.iter().filter(|&&p| is_drawn(p)).count();
        assert!(drawn > 200_000, "{name}: {drawn}");
        assert!(page.contains(&BASE64_STANDARD.encode(&bytes)), "{name}");
    }
}

#[test]
fn the_numbers_of_the_page_are_those_of_the_report() {
    let (page, folder) = page();
    let embedded: Value = serde_json::from_str(script(page, "report")).expect("JSON");
    let report = json(&folder.join("report.json"));
    assert_eq!(embedded, report);
    // What is printed is what the report says, to the digits printed.
    let mut cells = 0;
    for (at, key) in page.match_indices("data-key=\"") {
        let rest = &page[at + key.len()..];
        let (key, rest) = rest.split_once('"').expect("a key");
        let text = rest
            .split_once('>')
            .and_then(|(_, rest)| rest.split_once('<'))
            .expect("text")
            .0;
        let value = key.split('.').fold(&report, |value, part| &value[part]);
        let value = value
            .as_f64()
            .unwrap_or_else(|| panic!("{key} is no number"));
        let shown: f64 = text.replace(',', "").parse().expect("a number");
        assert!(
            (shown - value).abs() <= 0.006 * value.abs(),
            "{key}: {shown} for {value}"
        );
        cells += 1;
    }
    assert!(cells > 15, "{cells}");
    assert!(report["error"]["over_holes"]["area_percent"].as_f64() > Some(1.0));
    assert!(page.contains("over holes"), "the legend knows of holes");
}

#[test]
fn the_geometry_of_the_page_is_that_of_the_files() {
    let (page, folder) = page();
    let scene: Value = serde_json::from_str(script(page, "scene")).expect("JSON");
    assert_eq!(scene["up"], "z");
    let bytes = |value: &Value| {
        BASE64_STANDARD
            .decode(value.as_str().expect("text"))
            .expect("base64")
    };
    assert_eq!(bytes(&scene["colors"]).len(), 3 * 256);
    let files = [
        ("target", HOSTILE),
        ("cage", "control.obj"),
        ("surface", "surface.ply"),
    ];
    for (name, file) in files {
        let layer = &scene["layers"][name];
        let mesh = read_surface(&folder.join(file)).expect(file).mesh;
        let triangles = mesh.triangulate().triangles.len();
        let vertices = layer["vertex_count"].as_u64().expect("a count") as usize;
        assert_eq!(layer["triangles"], triangles, "{name}");
        let (words, indices) = (bytes(&layer["vertices"]), bytes(&layer["indices"]));
        assert_eq!(
            (words.len(), indices.len()),
            (12 * vertices, 12 * triangles),
            "{name}"
        );
        let inside =
            |word: &[u8]| (u32::from_le_bytes(word.try_into().expect("4")) as usize) < vertices;
        assert!(indices.chunks(4).all(inside), "{name}");
        // Every vertex of the file is in the page, to 16 bits.
        let quantized: Vec<u16> = words
            .chunks(2)
            .map(|w| u16::from_le_bytes([w[0], w[1]]))
            .collect();
        let mut found: Vec<_> = quantized.chunks(6).map(|v| [v[0], v[1], v[2]]).collect();
        found.sort_unstable();
        found.dedup();
        let referenced = mesh
            .corners()
            .iter()
            .collect::<std::collections::BTreeSet<_>>()
            .len();
        assert!(
            found.len() <= referenced && found.len() * 100 > referenced * 99,
            "{name}"
        );
    }
    let mut scan = read_surface(&folder.join(HOSTILE))
        .expect("a scan")
        .mesh
        .triangulate();
    let frame = Frame::of(&scan).expect("an extent");
    for p in &mut scan.positions {
        *p = frame.to_unit(*p);
    }
    let scan = topology::oriented(&topology::cleaned(&scan));
    let features = Features::find(&Device::Cpu, &scan, Scale::Automatic).expect("features");
    let layers = Vec::from(ridge_layers(&features)).into_iter();
    let layers: Vec<_> = layers.chain(point_layers(&features)).collect();
    let shown = scene["features"].as_array().expect("sorts");
    assert_eq!(shown.len(), layers.len());
    let mut all = 0;
    for (sort, layer) in shown.iter().zip(&layers) {
        assert_eq!(sort["name"], layer.name);
        let lines = sort["lines"].as_array().expect("lines");
        for (lines, strokes) in lines.iter().zip(&layer.strokes) {
            assert_eq!(bytes(&lines["ends"]).len(), 16 * strokes.segments.len());
            all += strokes.segments.len();
        }
    }
    assert!(all > 20, "{all}");
    let edges_in_page = bytes(&scene["layers"]["cage"]["edges"]).len() / 8;
    let control = read_surface(&folder.join("control.obj"))
        .expect("a cage")
        .mesh;
    assert_eq!(edges_in_page, edges(&control).len());
}

#[test]
fn a_cloud_is_shown_as_points() {
    let folder = folder("cloud");
    let ball = shapes::sphere(0.4, 3);
    let cloud = TriangleMesh {
        positions: ball.positions.clone(),
        triangles: Vec::new(),
    };
    let surface = PolygonMesh::from(ball);
    let subject = Subject {
        covered: &[],
        name: "points.xyz",
        target: &cloud,
        cage: &surface,
        surface: &surface,
        distances: None,
        up: Axis::Y,
    };
    let drawn = Page::new(&Device::Cpu, &subject).expect("a page");
    let report = Report::new("fit");
    drawn.write(&folder, &report, "vorofit").expect("written");
    let page = std::fs::read_to_string(folder.join("index.html")).expect("a page");
    let scene: Value = serde_json::from_str(script(&page, "scene")).expect("JSON");
    let target = &scene["layers"]["target"];
    assert_eq!(target["triangles"], 0);
    assert_eq!(target["vertex_count"], cloud.positions.len());
    assert_eq!(scene["layers"]["surface"]["valued"], false);
    assert_eq!(scene["features"], serde_json::json!([]));
    assert!(!page.contains("id=\"legend\""), "no colours, no legend");
    let (_, _, pixels) = decoded(&std::fs::read(folder.join("target.png")).expect("a picture"));
    let points = pixels.iter().filter(|&&p| is_drawn(p)).count();
    assert!((1000..20_000).contains(&points), "{points}");
}

#[test]
fn a_hostile_name_stays_a_name() {
    let (page, folder) = page();
    assert!(!page.contains("a <b>"), "escaped everywhere");
    assert!(
        page.contains(
            "<h1>a &lt;b&gt;&amp;&quot;&#39;{{script}}$(x).ply from 98 control points</h1>"
        )
    );
    assert_eq!(page.matches("</script>").count(), 3);
    // The command repeats the run in a shell: it says the same words.
    let start =
        page.find("<pre id=\"command\">").expect("the command") + "<pre id=\"command\">".len();
    let command = &page[start..start + page[start..].find("</pre>").expect("its end")];
    let command = [
        ("&lt;", "<"),
        ("&gt;", ">"),
        ("&quot;", "\""),
        ("&#39;", "'"),
        ("&amp;", "&"),
    ]
    .iter()
    .fold(command.to_owned(), |text, (from, to)| {
        text.replace(from, to)
    });
    let echo = command.replacen("vorofit", "printf '%s\\n'", 1);
    let output = std::process::Command::new("sh")
        .args(["-c", &echo])
        .output()
        .expect("a shell");
    let words = text(&output.stdout);
    let words: Vec<_> = words.lines().collect();
    assert_eq!(words[..2], ["fit", path_text(&folder.join(HOSTILE))]);
    assert_eq!(words.len(), 18);
}

#[test]
fn a_folder_of_something_else_is_left_alone() {
    let folder = folder_with_scan("foreign");
    let at = |name: &str| folder.join(name).to_str().expect("UTF-8").to_owned();
    let fit = |report: &str| {
        let (scan, out, report) = (at("scan.ply"), at("c.obj"), at(report));
        run(&[
            "fit",
            &scan,
            "-o",
            &out,
            "--control-points",
            "26",
            "--template",
            "bbox",
            "--iterations",
            "2",
            "--report",
            &report,
        ])
    };
    std::fs::create_dir(folder.join("site")).expect("a folder");
    std::fs::write(folder.join("site/index.html"), "<p>mine").expect("a page");
    std::fs::write(folder.join("file"), "mine").expect("a file");
    std::fs::create_dir(folder.join("album")).expect("a folder");
    std::fs::write(folder.join("album/target.png"), "mine").expect("a picture");
    for (place, named) in [
        ("site", "index.html"),
        ("file", "file"),
        ("album", "target.png"),
        ("file/below", "file"),
    ] {
        let output = fit(place);
        assert_eq!(output.status.code(), Some(1), "{place}");
        assert!(
            text(&output.stderr).contains(named),
            "{place}: {}",
            text(&output.stderr)
        );
        assert!(!folder.join("c.obj").exists(), "refused before the fit");
    }
    assert_eq!(
        std::fs::read_to_string(folder.join("site/index.html")).expect("a page"),
        "<p>mine"
    );
    // Beside other files it is welcome, and a page of ours is replaced.
    std::fs::create_dir(folder.join("mixed")).expect("a folder");
    std::fs::write(folder.join("mixed/notes.txt"), "mine").expect("a file");
    for _ in 0..2 {
        assert!(fit("mixed").status.success());
    }
    assert_eq!(names(Path::new(&at("mixed"))).len(), 5);
    let up = Axis::default();
    assert_eq!(View::with_up(up).up, DVec3::Y);
}
