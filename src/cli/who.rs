//! `cairn who`: whose photographs show what a view, a camera or a picture sees.

use std::path::PathBuf;
use std::str::FromStr;

use anyhow::Context as _;
use cairn_api::v1::{self, Unused, contributors_response};
use prost::{Message, Name};

use super::connect::Connection;
use super::exit::Cancelled;
use super::files::write;
use super::json::{self, Json};
use super::locate::{self, Asked};
use super::progress::Progress;
use super::viewpoint::FromWhere;

/// Photographs named beside a contributor.
const MAX_PHOTOGRAPHS: usize = 3;
/// Records named beside a contributor, of those that a curator confirmed and of the others.
const MAX_RECORDS: usize = 5;

/// `cairn who`.
#[derive(Debug, clap::Args)]
pub struct WhoArgs {
    /// The scene
    #[arg(value_name = "SCENE")]
    name: String,
    #[command(flatten)]
    from: FromWhere,
    /// Ask about a part of the picture alone: its left and upper edge, width and height, px
    #[arg(long, value_name = "LEFT,TOP,WIDTH,HEIGHT")]
    region: Option<Region>,
    /// Leave contributors out of the text who show less than so many per cent; they are summed up in one line
    #[arg(long, value_name = "PER CENT", default_value_t = 1.0)]
    min_share: f64,
    /// Also draw a map: the render, beside it every pixel in the colour of whose photographs show most of it, and a
    /// legend, PNG
    #[arg(long, value_name = "FILE")]
    map: Option<PathBuf>,
    /// Instead, work out how much the view would change without each of the N contributors who show most of it, 1 to 20;
    /// what that takes is said first
    #[arg(long, value_name = "N", conflicts_with_all = ["region", "map", "csv", "min_share"])]
    necessity: Option<u32>,
    /// Print a table for spreadsheets, a line for each photograph
    #[arg(long, conflicts_with = "json")]
    csv: bool,
    #[command(flatten)]
    json: Json,
}

/// A rectangle as it is written on the command line.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Region(v1::Region);

impl FromStr for Region {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Vec<u32> = text.split(',').filter_map(|number| number.trim().parse().ok()).collect();
        match (&numbers[..], text.split(',').count()) {
            (&[left, top, width, height], 4) => Ok(Self(v1::Region { left, top, width, height })),
            _ => Err("expected four whole numbers: left,top,width,height, such as 0,120,64,48".to_owned()),
        }
    }
}

/// Answers `cairn who`.
pub async fn who(line: &Connection, args: WhoArgs) -> anyhow::Result<()> {
    anyhow::ensure!(
        (0.0..=100.0).contains(&args.min_share),
        "--min-share is {}; expected a number from 0 to 100",
        args.min_share
    );
    let Asked { viewpoint, located } = locate::asked(line, &args.name, args.from).await?;
    let viewpoint = Some(viewpoint);
    if let Some(contributors) = args.necessity {
        anyhow::ensure!(contributors > 0, "--necessity is 0; expected a number of contributors, 1 to 20");
        let request = v1::NecessityRequest { scene: args.name, viewpoint, contributors };
        return necessity(line, request, located, args.json.json).await;
    }
    let (region, map) = (args.region.map(|region| region.0), args.map.is_some());
    let request = v1::ContributorsRequest { scene: args.name.clone(), viewpoint, region, map };
    let mut answer = line.about(&args.name).query().contributors(request).await?.into_inner();
    let drawn = std::mem::take(&mut answer.map_png);
    if let Some(path) = &args.map {
        write(path, &drawn)?;
    }
    if args.json.json {
        return print_json(&answer, located.as_ref());
    }
    say_where(located.as_ref(), args.csv)?;
    let said = if args.csv { table(&answer) } else { text(&answer, args.min_share / 100.0) };
    print!("{said}");
    if let (Some(path), false) = (&args.map, args.csv) {
        println!("map in {}", path.display());
    }
    Ok(())
}

/// Prints an answer, with the camera of the picture that it is about.
fn print_json<M: Message + Name>(answer: &M, located: Option<&v1::FoundCamera>) -> anyhow::Result<()> {
    let mut answer = json::of(answer)?;
    if let (Some(found), Some(fields)) = (located, answer.as_object_mut()) {
        fields.insert("located".to_owned(), json::of(found)?);
    }
    json::print_value(&answer)
}

/// Says where the picture was taken that was asked about; beside a table to standard error.
fn say_where(located: Option<&v1::FoundCamera>, beside_a_table: bool) -> anyhow::Result<()> {
    let Some(found) = located else { return Ok(()) };
    for said in locate::in_words(found)? {
        if beside_a_table { eprintln!("{said}") } else { println!("{said}") }
    }
    Ok(())
}

/// Has necessity worked out, and shows how far it is. The first Ctrl-C ends it.
async fn necessity(
    line: &Connection,
    request: v1::NecessityRequest,
    located: Option<v1::FoundCamera>,
    as_json: bool,
) -> anyhow::Result<()> {
    use v1::necessity_response::What;
    let mut interrupt = tokio::spawn(tokio::signal::ctrl_c());
    let scene = request.scene.clone();
    let mut stream = line.about(&scene).query().necessity(request).await?.into_inner();
    let mut shown = Progress::new(true);
    let answer = loop {
        let message = tokio::select! {
            message = stream.message() => message?,
            interrupt = &mut interrupt => {
                interrupt??;
                shown.end();
                return Err(Cancelled("cancelled before there was an answer".into()).into());
            }
        };
        match message.context("the line ended before there was an answer")?.what {
            Some(What::Cost(cost)) => eprintln!("{}", cost_in_words(&cost)),
            Some(What::Progress(at)) => shown.draw("per cent", (100.0 * at.done) as u64, 100, "", at.seconds_left),
            Some(What::Answer(answer)) => break answer,
            None => anyhow::bail!("the daemon sent a message that says nothing"),
        }
    };
    shown.end();
    if as_json {
        return print_json(&answer, located.as_ref());
    }
    say_where(located.as_ref(), false)?;
    for of in &answer.contributors {
        println!("{}", needed_in_words(of));
    }
    Ok(())
}

fn cost_in_words(cost: &v1::NecessityCost) -> String {
    let v1::NecessityCost { contributors, photographs, bytes, seconds } = cost;
    let mib = *bytes as f64 / f64::from(1 << 20);
    format!(
        "solving for the colours of {photographs} photographs without each of {contributors} contributors takes about {seconds:.0} s and {mib:.0} MiB"
    )
}

fn needed_in_words(of: &v1::NeededContributor) -> String {
    let levels = 255.0 * of.change;
    format!("without {}: colours move by {levels:.1} of 255 levels (shows {:.1} %)", of.name, 100.0 * of.share)
}

/// Those who show `min_share` or more; how many others there are, and what they show together.
fn shown(answer: &v1::ContributorsResponse, min_share: f64) -> (&[v1::ContributorShare], usize, f64) {
    let all = &answer.contributors;
    // They come with the largest share first.
    let (shown, others) = all.split_at(all.partition_point(|of| of.share >= min_share));
    (shown, others.len(), others.iter().map(|of| of.share).sum())
}

/// The answer for people.
fn text(answer: &v1::ContributorsResponse, min_share: f64) -> String {
    let mut lines = Vec::new();
    let mut line = |share: f64, what: String| lines.push(format!("{:6.1} %  {what}", 100.0 * share));
    let (shown, others, theirs) = shown(answer, min_share);
    for of in shown {
        line(of.share, format!("{}: {}{}", of.name, photographs(&of.photographs), records(of)));
    }
    match others {
        0 => {}
        1 => line(theirs, "one other contributor".into()),
        others => line(theirs, format!("{others} other contributors together")),
    }
    for (share, what) in [
        (answer.excluded, "photographs that were excluded since the training"),
        (answer.unseen, "shown by no photograph"),
        (answer.behind, "behind the scene (sky or background)"),
    ] {
        if share >= 0.0005 {
            line(share, what.into());
        }
    }
    lines.extend(photographed(answer));
    lines.push(match &answer.answer {
        Some(contributors_response::Answer::Identity(found)) => {
            let records: Vec<String> = found.record_indices.iter().map(u64::to_string).collect();
            let records = match records[..] {
                [] => "no owner record yet; `cairn owners sign` makes one".to_owned(),
                _ => format!("owner records at index: {}", records.join(", ")),
            };
            format!("the place is identity {}'s: {}; {records}", found.number, found.label)
        }
        _ => "the place is no identity's".to_owned(),
    });
    lines.push(String::new());
    lines.join("\n")
}

/// Who took the view that was asked about, and why they get no share for it; `None` for a camera.
fn photographed(answer: &v1::ContributorsResponse) -> Option<String> {
    let by = &answer.photographed_by;
    match answer.view_unused() {
        Unused::Excluded => Some("the view itself is excluded: no contributor gets a share for it".to_owned()),
        Unused::HeldOut => Some(format!(
            "the view itself was photographed by {by}, who gets no share for it: it is held out of training and taught nothing"
        )),
        _ => (!by.is_empty()).then(|| format!("the view itself was photographed by {by}")),
    }
}

/// A contributor's photographs that show most of it.
fn photographs(all: &[v1::PhotographShare]) -> String {
    let first = all.iter().take(MAX_PHOTOGRAPHS).map(|of| format!("{} {:.1} %", of.view_name, 100.0 * of.share));
    let mut named = first.collect::<Vec<_>>().join(", ");
    if all.len() > MAX_PHOTOGRAPHS {
        named.push_str(&format!(" and {} more", all.len() - MAX_PHOTOGRAPHS));
    }
    named
}

/// The owner records that credit a contributor, confirmed ones first; empty without any.
fn records(of: &v1::ContributorShare) -> String {
    let (confirmed, others): (Vec<_>, Vec<_>) = of.records.iter().partition(|record| record.confirmed);
    let first = |records: Vec<&v1::CreditingRecord>, what: &str| {
        let named: Vec<String> = records.iter().take(MAX_RECORDS).map(|record| record.index.to_string()).collect();
        let more = if records.len() > MAX_RECORDS { " and more" } else { "" };
        (!named.is_empty()).then(|| format!("{what} {}{more}", named.join(", ")))
    };
    let parts = [first(confirmed, "name confirmed: record"), first(others, "name unconfirmed: record")];
    let parts: Vec<String> = parts.into_iter().flatten().collect();
    let more = if of.more_records { "; and maybe more" } else { "" };
    if parts.is_empty() { more.to_owned() } else { format!("; {}{more}", parts.join("; ")) }
}

/// The answer as comma-separated values (RFC 4180): a line for each photograph, and one for each part that is no
/// contributor's. The last column's sum is 100. Records are by log index, and a `?` behind one says that it is unconfirmed;
/// `more_records` says where there may be others.
fn table(answer: &v1::ContributorsResponse) -> String {
    let mut lines = vec!["kind,contributor,photograph,records,more_records,share_percent".to_owned()];
    let per_cent = |share: f64| format!("{:.4}", 100.0 * share);
    for of in &answer.contributors {
        let record =
            |record: &v1::CreditingRecord| format!("{}{}", record.index, if record.confirmed { "" } else { "?" });
        let records = of.records.iter().map(record).collect::<Vec<_>>().join(" ");
        let more = if of.more_records { "maybe" } else { "" };
        for photograph in &of.photographs {
            let [name, view] = [&of.name, &photograph.view_name].map(|text| cell(text));
            lines.push(format!("photograph,{name},{view},{records},{more},{}", per_cent(photograph.share)));
        }
    }
    for (kind, share) in [("excluded", answer.excluded), ("unseen", answer.unseen), ("behind", answer.behind)] {
        lines.push(format!("{kind},,,,,{}", per_cent(share)));
    }
    lines.push(String::new());
    lines.join("\r\n")
}

/// A cell in quotes, which spreadsheets take for text: what begins like a formula has an apostrophe before it.
fn cell(text: &str) -> String {
    let formula = text.starts_with(['=', '+', '-', '@', '\t', '\r']);
    format!("\"{}{}\"", if formula { "'" } else { "" }, text.replace('"', "\"\""))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer() -> v1::ContributorsResponse {
        let photograph = |n: usize, share| v1::PhotographShare { view_name: format!("view_{n}.jpg"), share };
        let of = |name: &str, shares: &[f64]| v1::ContributorShare {
            name: name.into(),
            share: shares.iter().sum(),
            photographs: shares.iter().enumerate().map(|(n, share)| photograph(n, *share)).collect(),
            ..v1::ContributorShare::default()
        };
        v1::ContributorsResponse {
            contributors: vec![
                of("ada", &[0.3, 0.1, 0.05, 0.05]),
                of("bob \"B\"", &[0.1]),
                of("cy", &[0.004]),
                of("di", &[0.002]),
            ],
            unseen: 0.194,
            behind: 0.2,
            photographed_by: "eve".into(),
            ..v1::ContributorsResponse::default()
        }
    }

    #[test]
    fn people_read_shares_and_who_shows_little_is_summed_up() {
        let said = text(&answer(), 0.01);
        let lines: Vec<&str> = said.lines().collect();
        assert_eq!(lines[0], "  50.0 %  ada: view_0.jpg 30.0 %, view_1.jpg 10.0 %, view_2.jpg 5.0 % and 1 more");
        assert_eq!(lines[2], "   0.6 %  2 other contributors together");
        assert_eq!(lines[3..5], ["  19.4 %  shown by no photograph", "  20.0 %  behind the scene (sky or background)"]);
        assert_eq!(lines[5], "the view itself was photographed by eve");
        assert!(!said.contains("excluded") && text(&answer(), 0.0).contains("cy: view_0.jpg 0.4 %"));
    }

    #[test]
    fn a_view_that_taught_nothing_is_said_to_earn_no_share() {
        let said = |why: Unused, by: &str| {
            let answer = v1::ContributorsResponse { view_unused: why.into(), photographed_by: by.into(), ..answer() };
            text(&answer, 0.01).lines().nth(5).unwrap().to_owned()
        };
        let held_out = said(Unused::HeldOut, "eve");
        assert!(held_out.contains("photographed by eve, who gets no share for it: it is held out"), "{held_out}");
        assert_eq!(said(Unused::Excluded, ""), "the view itself is excluded: no contributor gets a share for it");
        assert!(said(Unused::Unspecified, "").starts_with("the place is"));
    }

    #[test]
    fn a_table_adds_up_and_quotes_names() {
        let said = table(&answer());
        assert!(said.contains("\r\nphotograph,\"bob \"\"B\"\"\",\"view_0.jpg\",,,10.0000\r\n"), "{said}");
        let shares = said.lines().skip(1).map(|line| line.rsplit(',').next().unwrap().parse::<f64>().unwrap());
        assert!((shares.sum::<f64>() - 100.0).abs() < 1e-6);
        assert_eq!(cell("=HYPERLINK(1)"), "\"'=HYPERLINK(1)\"");
    }

    #[test]
    fn records_stand_beside_shares_and_say_whether_a_curator_confirmed_them() {
        let mut answer = answer();
        let record = |index, confirmed| v1::CreditingRecord { index, confirmed };
        answer.contributors[0].records = vec![record(0, false), record(2, true), record(8, false)];
        answer.contributors[2].records = (0..9).map(|index| record(index, false)).collect();
        let said = text(&answer, 0.0);
        assert!(said.contains(" and 1 more; name confirmed: record 2; name unconfirmed: record 0, 8\n"), "{said}");
        assert!(said.contains("cy: view_0.jpg 0.4 %; name unconfirmed: record 0, 1, 2, 3, 4 and more\n"), "{said}");
        assert!(table(&answer).contains("\r\nphotograph,\"ada\",\"view_0.jpg\",0? 2 8?,,30.0000\r\n"));
        answer.contributors[0].more_records = true;
        assert!(text(&answer, 0.0).contains("; name unconfirmed: record 0, 8; and maybe more\n"));
        assert!(table(&answer).contains(",0? 2 8?,maybe,30.0000\r\n"));
    }

    #[test]
    fn a_region_is_four_numbers() {
        let region = "3, 4,50,60".parse::<Region>().unwrap().0;
        assert_eq!((region.left, region.top, region.width, region.height), (3, 4, 50, 60));
        for wrong in ["3,4,50", "3,4,50,60,70", "3,4,-50,60", "a,b,c,d", ""] {
            assert!(wrong.parse::<Region>().unwrap_err().contains("four whole numbers"), "{wrong:?}");
        }
    }
}
