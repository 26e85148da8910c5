//! TLS and mutual TLS through the real daemon, with certificates made here.

use cairn_testkit::daemon::{Daemon, Place};
use rcgen::{BasicConstraints, CertificateParams, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, date_time_ymd};

/// An authority; its certificate is in `NAME.pem`.
fn authority(place: &Place, name: &str) -> Issuer<'static, KeyPair> {
    let mut params = CertificateParams::new(Vec::new()).unwrap();
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    params.distinguished_name.push(rcgen::DnType::CommonName, name);
    let key = KeyPair::generate().unwrap();
    std::fs::write(place.path(&format!("{name}.pem")), params.self_signed(&key).unwrap().pem()).unwrap();
    Issuer::new(params, key)
}

/// A certificate of the authority's in `NAME.pem`, and its key in `NAME.key`.
fn certificate(place: &Place, issuer: &Issuer<'static, KeyPair>, name: &str, purpose: ExtendedKeyUsagePurpose) {
    let mut params = CertificateParams::new(vec!["127.0.0.1".to_owned(), "localhost".to_owned()]).unwrap();
    params.extended_key_usages.push(purpose);
    let key = KeyPair::generate().unwrap();
    let certificate = params.signed_by(&key, issuer).unwrap();
    std::fs::write(place.path(&format!("{name}.pem")), certificate.pem()).unwrap();
    std::fs::write(place.path(&format!("{name}.key")), key.serialize_pem()).unwrap();
}

fn tls(place: &Place, certificate: &str, key: &str, client_ca: &str) -> String {
    let text = |name: &str| if name.is_empty() { String::new() } else { place.text(name) };
    let [certificate, key, client_ca] = [certificate, key, client_ca].map(text);
    format!("[server.tls]\ncertificate = {certificate:?}\nkey = {key:?}\nclient_ca = {client_ca:?}\n")
}

fn refused(place: &Place, arguments: &[&str], says: &str) {
    let output = place.cairn(arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && said.contains(says), "cairn {arguments:?} does not say {says:?}: {said}");
}

#[test]
fn the_line_is_secured_and_each_end_may_ask_who_the_other_is() {
    let place = Place::new();
    let (ours, _) = (authority(&place, "ca"), authority(&place, "other-ca"));
    certificate(&place, &ours, "daemon", ExtendedKeyUsagePurpose::ServerAuth);
    certificate(&place, &ours, "ada", ExtendedKeyUsagePurpose::ClientAuth);
    let (ca, other) = (place.text("ca.pem"), place.text("other-ca.pem"));

    let daemon = Daemon::start(&place.path("data"), &tls(&place, "daemon.pem", "daemon.key", ""));
    assert!(daemon.url.starts_with("https://"), "{}", daemon.url);
    let list = ["scene", "list", "--connect", daemon.url.as_str()];
    place.cairn_ok(&[&list[..], &["--tls-ca", &ca]].concat());
    refused(&place, &list, "--tls-ca");
    refused(&place, &[&list[..], &["--tls-ca", &other]].concat(), "nothing in the file of --tls-ca vouches for it");
    let plain = daemon.url.replace("https", "http");
    refused(&place, &["scene", "list", "--connect", &plain], "");
    assert!(daemon.terminate().success());

    let daemon = Daemon::start(&place.path("data"), &tls(&place, "daemon.pem", "daemon.key", "ca.pem"));
    let list = ["scene", "list", "--connect", daemon.url.as_str(), "--tls-ca", ca.as_str()];
    let (cert, key) = (place.text("ada.pem"), place.text("ada.key"));
    place.cairn_ok(&[&list[..], &["--tls-cert", &cert, "--tls-key", &key]].concat());
    refused(&place, &list, "");
    // A certificate that is for daemons does not do for clients.
    let (cert, key) = (place.text("daemon.pem"), place.text("daemon.key"));
    refused(&place, &[&list[..], &["--tls-cert", &cert, "--tls-key", &key]].concat(), "");
    refused(
        &place,
        &[&list[..], &["--tls-cert", &key, "--tls-key", &key]].concat(),
        "holds no PEM section CERTIFICATE",
    );
}

/// A certificate that vouches for itself, for `name`, from the begin of one year to that of another, in `NAME.pem`, and
/// its key in `NAME.key`.
fn own(place: &Place, name: &str, is_ca: IsCa, [from, to]: [i32; 2]) {
    let mut params = CertificateParams::new(vec![name.to_owned()]).unwrap();
    params.is_ca = is_ca;
    (params.not_before, params.not_after) = (date_time_ymd(from, 1, 1), date_time_ymd(to, 1, 1));
    let key = KeyPair::generate().unwrap();
    std::fs::write(place.path(&format!("{name}.pem")), params.self_signed(&key).unwrap().pem()).unwrap();
    std::fs::write(place.path(&format!("{name}.key")), key.serialize_pem()).unwrap();
}

#[test]
fn a_certificate_that_is_refused_is_answered_with_what_helps() {
    let place = Place::new();
    let now = [2020, 2190];
    for (name, is_ca, years, says) in [
        ("127.0.0.1", IsCa::Ca(BasicConstraints::Unconstrained), now, "basicConstraints=critical,CA:FALSE"),
        ("cairn.example", IsCa::ExplicitNoCa, now, "it is for another name"),
        ("127.0.0.1", IsCa::ExplicitNoCa, [2019, 2020], "its time is over"),
        ("127.0.0.1", IsCa::ExplicitNoCa, [2180, 2190], "its time is still to come"),
    ] {
        own(&place, name, is_ca, years);
        let (certificate, key) = (format!("{name}.pem"), format!("{name}.key"));
        let daemon = Daemon::start(&place.path("data"), &tls(&place, &certificate, &key, ""));
        let said = place.cairn_refused(&["jobs", "--connect", &daemon.url, "--tls-ca", &place.text(&certificate)]);
        assert!(said.contains("the certificate of https://") && said.contains(says), "{said}");
        assert!(!said.contains("no daemon is reached"), "{said}");
    }
}

/// The page's command makes a certificate that a client takes.
#[test]
fn the_certificate_of_the_page_is_taken() {
    let place = Place::new();
    let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/guide/access.md")).unwrap();
    let at = page.find("openssl req").expect("the page shows how a certificate is made");
    let command = page[at..].split("```").next().unwrap().replace("cairn.example", "localhost");
    if std::process::Command::new("openssl").arg("version").output().is_err() {
        println!("SKIPPED the_certificate_of_the_page_is_taken: no openssl on this system");
        return;
    }
    let made = std::process::Command::new("sh").args(["-c", &command]).current_dir(place.dir.path()).output().unwrap();
    assert!(made.status.success(), "{command}\n{}", String::from_utf8_lossy(&made.stderr));
    let daemon = Daemon::start(&place.path("data"), &tls(&place, "daemon.pem", "daemon.key", ""));
    let url = daemon.url.replace("127.0.0.1", "localhost");
    place.cairn_ok(&["scene", "list", "--connect", &url, "--tls-ca", &place.text("daemon.pem")]);
}

#[test]
fn bad_files_are_named() {
    let place = Place::new();
    let ours = authority(&place, "ca");
    certificate(&place, &ours, "daemon", ExtendedKeyUsagePurpose::ServerAuth);
    certificate(&place, &ours, "ada", ExtendedKeyUsagePurpose::ClientAuth);
    for (certificate, key, says) in [
        ("none.pem", "daemon.key", "none.pem"),
        ("daemon.key", "daemon.key", "daemon.key holds no PEM section CERTIFICATE"),
        ("daemon.pem", "daemon.pem", "daemon.pem holds no PEM section PRIVATE KEY"),
        ("daemon.pem", "ada.key", "ada.key"),
    ] {
        let config = place.path("bad.toml");
        let settings = tls(&place, certificate, key, "") + "[server]\nbind = \"127.0.0.1:0\"\n";
        std::fs::write(&config, settings).unwrap();
        let output = cairn_testkit::daemon::command()
            .args(["serve", "--data", &place.text("data"), "--config", config.to_str().unwrap()])
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains(says), "{certificate} and {key}: {said}");
    }
}
