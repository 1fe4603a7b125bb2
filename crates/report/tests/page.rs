//! A page holds its charts, is self-contained and survives what users call things.

use fixtrail_report::{Comparison, Entry, Page, Series, render, render_comparison};
use fixtrail_sim::metrics::{Kind, Loss, Losses, Score, kinematic, score};
use fixtrail_sim::scenario::{Demo, demo};
use fixtrail_track::anchors::Anchors;
use fixtrail_track::layout::Layout;
use fixtrail_track::packet::{self, Content, Packet};
use fixtrail_track::predictive::{self, Foretold};
use fixtrail_track::target::{TargetPackets, TargetTrail};
use fixtrail_track::truth::TargetTruth;

mod synthetic;
use synthetic::{Errs, linear_trail, long_walk, trail};

const ERRS: Errs = Errs { sd_m: 0.15, claim: 1.0, growth: 0.5 };

fn scored(trails: &[TargetTrail], layout: &Layout, truth: &[TargetTruth]) -> Score {
    score(trails, layout, &kinematic(layout, &[]), truth, Kind::Filter).unwrap()
}

/// The demo with two invented estimators.
fn walk(run: &Demo) -> String {
    let layout = Layout::kinematic(2, 2, &[]);
    let make = |errs, seed| [trail(&run.truth[0], &run.packets[0], 2, errs, seed)];
    let trails = [make(ERRS, 1), make(Errs { claim: 0.4, ..ERRS }, 2)];
    let scores = trails.each_ref().map(|t| scored(t, &layout, &run.truth));
    render(&Page {
        title: "A walk",
        subtitle: "through a hall",
        notes: &["a note".to_owned()],
        layout: &layout,
        series: &[
            Series { name: "ekf", trails: &trails[0], score: Some(&scores[0]) },
            Series { name: "fms", trails: &trails[1], score: Some(&scores[1]) },
        ],
        truth: &run.truth,
        anchors: &run.anchors,
        theory: None,
        packets: &run.packets,
    })
}

/// What no page may contain: references to elsewhere, and numbers that are none in a drawing.
fn assert_self_contained_and_finite(page: &str) {
    for reference in ["http", "//cdn", "src=", "href=", "@import", "url(h", "url(/"] {
        assert!(!page.contains(reference), "{reference}");
    }
    for attribute in
        [" d=\"", " x=\"", " y=\"", " cx=\"", " cy=\"", "translate(", "data-x=\"", "data-y=\"", "viewBox=\""]
    {
        for value in page.split(attribute).skip(1) {
            let value = value.split(['"', ')']).next().unwrap();
            assert!(!value.contains("NaN") && !value.contains("inf"), "{attribute}{value}");
        }
    }
    // Tags that are opened are closed, as browsers need it in a drawing.
    for tag in ["svg", "g", "path", "text", "figure", "table", "section", "button"] {
        let opened = page.matches(&format!("<{tag} ")).count() + page.matches(&format!("<{tag}>")).count();
        assert_eq!(opened, page.matches(&format!("</{tag}>")).count(), "{tag}");
    }
}

#[test]
fn demo_page_has_every_chart_with_titles_units_and_captions() {
    let page = walk(&demo(1));
    assert_self_contained_and_finite(&page);
    for heading in ["Plan", "Error over time", "How large errors are", "Surprise over time", "What arrived"] {
        assert_eq!(page.matches(&format!("<h3>{heading}</h3>")).count(), 1, "{heading}");
    }
    assert_eq!(page.matches("<figure").count(), page.matches("<figcaption>").count());
    for title in
        ["x [m]", "y [m]", "position error [m]", "share of instants [%]", "NIS [1]", "time from the first instant [s]"]
    {
        assert!(page.contains(title), "{title}");
    }
    for name in ["A1", "A6", "ekf", "fms", "a note", "through a hall", "range A3"] {
        assert!(page.contains(name), "{name}");
    }
    assert!(page.contains("consistent") && page.contains("over-confident"));
    assert!(page.contains("prefers-color-scheme:dark") && page.contains("width=device-width"));
}

#[test]
fn equal_pages_give_equal_bytes() {
    let run = demo(3);
    assert_eq!(walk(&run), walk(&run));
}

#[test]
fn texts_of_users_are_escaped() {
    let evil = "<script>alert(1)</script>\"&'";
    let truth = [TargetTruth { target: Some(evil.to_owned()), ..long_walk("", 50, 1) }, long_walk("b", 50, 2)];
    let packets = truth.each_ref().map(|t| TargetPackets { target: t.target.clone(), packets: Vec::new() });
    let layout = Layout::kinematic(2, 2, &[]);
    let trails = [0, 1].map(|i| trail(&truth[i], &packets[i], 1, ERRS, 1));
    let score = scored(&trails, &layout, &truth);
    let mut anchors = Anchors::default();
    anchors.add(evil, [0.0; 3]);
    let page = render(&Page {
        title: evil,
        subtitle: evil,
        notes: &[evil.to_owned()],
        layout: &layout,
        series: &[Series { name: evil, trails: &trails, score: Some(&score) }],
        truth: &truth,
        anchors: &anchors,
        theory: None,
        packets: &packets,
    });
    assert!(!page.contains("<script>alert"));
    assert_eq!(page.matches("<script>").count(), 1);
    assert!(page.contains("&lt;script&gt;alert(1)&lt;/script&gt;&quot;&amp;"));
}

#[test]
fn linear_page_shows_states_and_breaks_lines_where_unobservable() {
    let trails = [linear_trail(400)];
    let packets = [TargetPackets {
        target: None,
        packets: (0..400)
            .map(|k| Packet {
                k: Some(k),
                ..Packet::new(
                    k as f64,
                    Content::Linear { z: vec![(k % 4 != 0).then_some(1.0), Some(2.0)], u: vec![] },
                    k + 1,
                )
            })
            .collect(),
    }];
    let page = render(&Page {
        title: "run",
        subtitle: "",
        notes: &[],
        layout: &Layout::linear(2),
        series: &[Series { name: "fms", trails: &trails, score: None }],
        truth: &[],
        anchors: &Anchors::default(),
        theory: None,
        packets: &packets,
    });
    assert_self_contained_and_finite(&page);
    for text in
        ["State x1", "State x2", "time index k", "Surprise over time", "What arrived", "unobservable", ">z1<", ">z2<"]
    {
        assert!(page.contains(text), "{text}");
    }
    assert!(!page.contains("<h3>Plan</h3>") && !page.contains("Error over time"));
    // One piece per stretch between unobservable rows: 40 gaps make 40 pieces.
    let line = page.split("<path class=\"line s0\" data-name=\"fms\" d=\"").nth(1).unwrap().split('"').next().unwrap();
    assert_eq!(line.matches('M').count(), 40);
    // Every fourth z1 is lost: 100 bars; z2 is one unbroken bar.
    let arrived: Vec<usize> = page
        .split("<path class=\"arrived\" d=\"")
        .skip(1)
        .map(|d| d.split('"').next().unwrap().matches('M').count())
        .collect();
    assert_eq!(arrived, [100, 1]);
}

#[test]
fn page_of_a_hundred_thousand_rows_and_three_estimators_stays_below_three_megabytes() {
    let truth = [long_walk("long", 100_000, 4)];
    let packets = [TargetPackets {
        target: Some("long".to_owned()),
        packets: truth[0]
            .points
            .iter()
            .enumerate()
            .map(|(i, p)| Packet::new(p.t_s, Content::Position(p.position_m), i as u64 + 1))
            .collect(),
    }];
    let none = TargetPackets { target: None, packets: Vec::new() };
    let layout = Layout::kinematic(2, 2, &[]);
    let trails = [1, 2, 3].map(|seed| [trail(&truth[0], &none, 1, Errs { growth: 0.0, sd_m: 5.0, ..ERRS }, seed)]);
    let scores = trails.each_ref().map(|t| scored(t, &layout, &truth));
    let series = [0, 1, 2].map(|i| Series { name: ["a", "b", "c"][i], trails: &trails[i], score: Some(&scores[i]) });
    let page = render(&Page {
        title: "long",
        subtitle: "",
        notes: &[],
        layout: &layout,
        series: &series,
        truth: &truth,
        anchors: &Anchors::default(),
        theory: None,
        packets: &packets,
    });
    assert_self_contained_and_finite(&page);
    assert!(page.len() < 3_000_000, "{}", page.len());
    assert!(page.contains("Of 300000 rows those are drawn"));
}

#[test]
fn dozens_of_targets_are_all_in_the_table_and_the_worst_in_detail() {
    let layout = Layout::kinematic(2, 2, &[]);
    let none = TargetPackets { target: None, packets: Vec::new() };
    let truth: Vec<_> = (0..30).map(|i| long_walk(&format!("tag{i:02}"), 200, i)).collect();
    let trails: Vec<_> = truth
        .iter()
        .enumerate()
        .map(|(i, t)| trail(t, &none, 1, Errs { growth: 0.0, sd_m: 0.1 * (1.0 + i as f64), ..ERRS }, i as u64))
        .collect();
    let score = scored(&trails, &layout, &truth);
    let page = render(&Page {
        title: "fleet",
        subtitle: "",
        notes: &[],
        layout: &layout,
        series: &[Series { name: "ekf", trails: &trails, score: Some(&score) }],
        truth: &truth,
        anchors: &Anchors::default(),
        theory: None,
        packets: &[],
    });
    assert_self_contained_and_finite(&page);
    let rows: Vec<&str> = page.split("<tr><th>tag").skip(1).map(|r| &r[..2]).collect();
    assert_eq!(rows.len(), 30);
    // Standard deviations differ by a factor of 30, so first and last of the order are certain; neighbours are not.
    assert!(rows[0] > "24" && rows[29] < "04", "{rows:?}");
    assert_eq!(page.matches("<h2 class=\"target\">").count(), 4);
    assert!(page.contains("26 are left out"));
}

#[test]
fn empty_trails_give_a_page_without_charts() {
    let trails =
        [TargetTrail { target: None, trail: fixtrail_track::trail::Trail::new(4, false), link: Default::default() }];
    let page = render(&Page {
        title: "nothing",
        subtitle: "",
        notes: &[],
        layout: &Layout::kinematic(2, 2, &[]),
        series: &[Series { name: "ekf", trails: &trails, score: None }],
        truth: &[],
        anchors: &Anchors::default(),
        theory: None,
        packets: &[],
    });
    assert_self_contained_and_finite(&page);
    assert!(page.contains("nothing"));
}

#[test]
fn one_axis_shows_position_over_time_with_its_unit() {
    use fixtrail_track::fix::{Estimate, Fix, Sink, Status};
    let mut t = fixtrail_track::trail::Trail::new(2, false);
    for k in 0..20 {
        t.fix(&Fix {
            k,
            t_s: Some(1.7e9 + k as f64),
            estimate: Some(Estimate { mean: &[k as f64, 1.0], cov: &[0.1, 0.0, 0.0, 0.1] }),
            status: Status::Updated,
            nis: None,
            nis_dof: 0,
            lagged: None,
        });
    }
    let trails = [TargetTrail { target: None, trail: t, link: Default::default() }];
    let page = render(&Page {
        title: "rail",
        subtitle: "",
        notes: &[],
        layout: &Layout::kinematic(2, 1, &[]),
        series: &[Series { name: "kalman", trails: &trails, score: None }],
        truth: &[],
        anchors: &Anchors::default(),
        theory: None,
        packets: &[],
    });
    assert_self_contained_and_finite(&page);
    assert!(page.contains("x [m]") && page.contains("vx [m/s]") && !page.contains("Surprise over time"));
}

#[test]
fn link_section_counts_what_is_not_zero_and_shows_theory() {
    use fixtrail_track::link::LinkReport;
    use fixtrail_track::theory::{Source, theory};
    let spec = "[model]\nkind = \"random-walk\"\naxes = 2\nnoise = 0.1\n[sensor]\nkind = \"position\"\nsd = 0.5\n";
    let spec = fixtrail_track::spec::parse(spec, std::path::Path::new("spec"), &mut |_| Ok(Vec::new())).unwrap();
    let told = (theory(&spec, Some(0.1), 0.5).unwrap(), Source::Spec);
    let page = |links: [LinkReport; 2], theory| {
        let trails =
            links.map(|link| TargetTrail { target: None, trail: fixtrail_track::trail::Trail::new(2, false), link });
        render(&Page {
            title: "",
            subtitle: "",
            notes: &[],
            layout: &Layout::kinematic(1, 2, &[]),
            series: &[Series { name: "kalman", trails: &trails, score: None }],
            truth: &[],
            anchors: &Anchors::default(),
            theory,
            packets: &[],
        })
    };
    assert!(!page(Default::default(), None).contains("<h2>Link</h2>"));
    let busy =
        LinkReport { too_late: 2, first_too_late: Some(31), copies: 3, repeats: 4, stale: 1, arrival: Some(0.75) };
    let html = page([busy, LinkReport { copies: 1500, arrival: Some(0.9), ..LinkReport::default() }], None);
    assert_self_contained_and_finite(&html);
    for part in [
        "2 packets came too late to be used, the first of the target in row 31",
        "1\u{2009}503 packets that had come already",
        "4 values equal to the one before",
        "1 value old by the sequence number",
        "arrival rates learnt on line: 0.750 to 0.900 over 2 targets",
    ] {
        assert!(html.contains(part), "{part}");
    }
    let html = page([LinkReport { arrival: Some(0.75), ..LinkReport::default() }, LinkReport::default()], None);
    assert!(
        html.contains("arrival rate learnt on line: 0.750") && !html.contains("too late") && !html.contains("equal to")
    );
    let html = page(Default::default(), Some(&told));
    assert_self_contained_and_finite(&html);
    // 0.285 m: √ of the root of λx² − w x − w r = 0 with λ = 0.5, w = 0.01, r = 0.25.
    assert!(
        html.contains("Theory, when 50 % of the packets arrive (by `link.arrival`), an instant every 0.1 s")
            && html.contains("<td>0.285</td>"),
    );
}

#[test]
fn comparison_says_which_is_best_and_what_uses_later_data() {
    let run = demo(1);
    let layout = Layout::kinematic(2, 2, &[]);
    let trails = [1, 2].map(|seed| [trail(&run.truth[0], &run.packets[0], 2, ERRS, seed)]);
    let scores = trails.each_ref().map(|t| scored(t, &layout, &run.truth));
    let series = [
        Series { name: "ekf", trails: &trails[0], score: Some(&scores[0]) },
        Series { name: "rts", trails: &trails[1], score: Some(&scores[1]) },
    ];
    let page = Page {
        title: "A walk",
        subtitle: "2 estimators",
        notes: &[],
        layout: &layout,
        series: &series,
        truth: &run.truth,
        anchors: &run.anchors,
        theory: None,
        packets: &run.packets,
    };
    let entry = |note, best| Entry { note, best, us_per_instant: 12.5, foretold: None, losses: &[] };
    let entries = [entry("", false), entry("uses later data", true)];
    let sentences = ["best: rts, by far".to_owned()];
    let html = render_comparison(&page, &Comparison { entries: &entries, sentences: &sentences });
    assert_self_contained_and_finite(&html);
    let rows: Vec<&str> = html.split("<tr>").collect();
    let row = |name: &str| *rows.iter().find(|r| r.contains(&format!("</span>{name}"))).unwrap();
    assert!(row("rts").contains(">best<") && row("rts").contains("uses later data") && row("rts").contains("12.5"));
    assert!(!row("ekf").contains(">best<") && !row("ekf").contains("later"));
    for text in ["Best: rts, by far.", "time [µs]", "RMSE [m]", "Error over time", "How large errors are", "Plan"] {
        assert!(html.contains(text), "{text}");
    }
    assert!(!html.contains("Score over time"));
}

#[test]
fn comparison_without_truth_draws_the_score_over_time() {
    let run = demo(1);
    let layout = Layout::kinematic(2, 2, &[]);
    let trails = [trail(&run.truth[0], &run.packets[0], 2, ERRS, 1)];
    let series =
        [Series { name: "ekf", trails: &trails, score: None }, Series { name: "fms", trails: &trails, score: None }];
    let page = Page {
        title: "A walk",
        subtitle: "2 estimators",
        notes: &[],
        layout: &layout,
        series: &series,
        truth: &[],
        anchors: &run.anchors,
        theory: None,
        packets: &run.packets,
    };
    let mut foretold = predictive::Score::default();
    let mut losses: Losses = vec![None];
    for k in 1..100 {
        let told = Foretold { k, t_s: None, kind: packet::Kind::Range, innovation: 0.25, var: 0.25, old: None };
        foretold.push(&told);
        losses.push((k % 10 != 5).then(|| Loss { t: k as f64, sum: -told.log_density(), weight: 1.0 }));
    }
    let losses = [losses];
    let entry = |best| Entry { note: "", best, us_per_instant: 1.0, foretold: Some(&foretold), losses: &losses };
    let html = render_comparison(&page, &Comparison { entries: &[entry(true), entry(false)], sentences: &[] });
    assert_self_contained_and_finite(&html);
    for text in ["Score over time", "RMS range [m]", "median range [m]", "ν²/S", "score [1]", "not foretold"] {
        assert!(html.contains(text), "{text}");
    }
    // By hand: 0.95 φ(½)/½ + 0.05/(5π (1 + 1/400)) = 0.66892 + 0.00318, and its logarithm.
    assert!(html.contains("-0.397"), "the score");
    assert!(!html.contains("Error over time") && !html.contains("How large errors are"));
}
