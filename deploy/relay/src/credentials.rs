//! Certificates: who may join a run, and whom a joining host may trust.
//!
//! A file has, as PEM, a host's certificate, its private key, and the certificate of the authority that both sides trust.

use crate::Failure;
use crate::net::set;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose, date_time_ymd,
};
use std::fs::{self, DirBuilder, OpenOptions};
use std::io::{ErrorKind, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::Path;
use zenoh::Config;

/// Largest file of credentials, bytes.
const MAX_BYTES: u64 = 1 << 16;

/// A host's credentials, each part as PEM.
#[derive(Debug)]
pub(crate) struct Credentials {
    certificate: String,
    key: String,
    authority: String,
}

impl Credentials {
    /// Those in `file`.
    pub(crate) fn read(file: &str) -> Result<Self, Failure> {
        let meta = fs::metadata(file).map_err(|error| format!("--credentials {file}: {error}"))?;
        if !meta.is_file() || meta.len() > MAX_BYTES {
            return Err(format!("--credentials {file}: accepted: a file of up to {MAX_BYTES} bytes").into());
        }
        let text = fs::read_to_string(file).map_err(|error| format!("--credentials {file}: {error}"))?;
        Self::parse(&text).ok_or_else(|| {
            let message = format!(
                "--credentials {file}: accepted: a certificate, its private key, and the authority's certificate, as \
                 `trestle hosts credentials` makes them"
            );
            message.into()
        })
    }

    fn parse(text: &str) -> Option<Self> {
        let mut parts = Vec::new();
        let mut rest = text;
        while let Some(begin) = rest.find("-----BEGIN ") {
            let part = &rest[begin..];
            let label = part["-----BEGIN ".len()..].split("-----").next()?;
            let last = format!("-----END {label}-----");
            let end = part.find(&last)? + last.len();
            parts.push((label.to_string(), format!("{}\n", &part[..end])));
            rest = &part[end..];
        }
        match <[_; 3]>::try_from(parts).ok()? {
            [(one, certificate), (two, key), (three, authority)]
                if one == "CERTIFICATE" && two.ends_with("PRIVATE KEY") && three == "CERTIFICATE" =>
            {
                Some(Self { certificate, key, authority })
            }
            _ => None,
        }
    }

    /// Makes both sides of a link prove who they are by these.
    pub(crate) fn apply(&self, config: &mut Config) -> Result<(), Failure> {
        set(config, "transport/link/tls/enable_mtls", "true")?;
        set(config, "transport/link/tls/verify_name_on_connect", "true")?;
        let parts = [
            ("root_ca_certificate_base64", &self.authority),
            ("listen_certificate_base64", &self.certificate),
            ("listen_private_key_base64", &self.key),
            ("connect_certificate_base64", &self.certificate),
            ("connect_private_key_base64", &self.key),
        ];
        for (key, pem) in parts {
            // Secrets cannot be read back. A link without one of them is not made.
            config.insert_json5(
                &format!("transport/link/tls/{key}"),
                &format!("{:?}", BASE64_STANDARD.encode(pem)),
            )?;
        }
        Ok(())
    }
}

/// Makes an authority and credentials by it in `dir`: `head.pem` for the host that listens, which is reached by `names`, and
/// `join.pem` for the hosts that join. The authority's key is not kept, so nobody can make others.
pub(crate) fn make(dir: &Path, names: &[&str]) -> Result<(), Failure> {
    let mut private = DirBuilder::new();
    match private.recursive(true).mode(0o700).create(dir) {
        Err(error) if error.kind() != ErrorKind::AlreadyExists => {
            return Err(format!("{}: {error}", dir.display()).into());
        }
        _ => {}
    }
    let mut authority = params(&[], "Trestle authority")?;
    authority.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    authority.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::DigitalSignature];
    let key = KeyPair::generate()?;
    let trusted = authority.self_signed(&key)?.pem();
    let issuer = Issuer::new(authority, key);
    for (file, names, name, purpose) in [
        ("head.pem", names, "Trestle head", ExtendedKeyUsagePurpose::ServerAuth),
        ("join.pem", &["joined"], "Trestle joined host", ExtendedKeyUsagePurpose::ClientAuth),
    ] {
        let mut own = params(names, name)?;
        own.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        own.extended_key_usages = vec![purpose];
        own.use_authority_key_identifier_extension = true;
        let key = KeyPair::generate()?;
        let certificate = own.signed_by(&key, &issuer)?.pem();
        let path = dir.join(file);
        OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(&path)
            .and_then(|mut opened| {
                opened.write_all([certificate, key.serialize_pem(), trusted.clone()].concat().as_bytes())
            })
            .map_err(|error| format!("{}: {error}", path.display()))?;
    }
    println!("{0}/head.pem is for the host that listens, {0}/join.pem for those that join", dir.display());
    Ok(())
}

/// A certificate of `name`, for a host that is reached by `names`.
fn params(names: &[&str], name: &str) -> Result<CertificateParams, Failure> {
    let names: Vec<String> = names.iter().map(|name| (*name).into()).collect();
    let mut params = CertificateParams::new(names)?;
    params.distinguished_name.push(DnType::CommonName, name);
    // A run's credentials are thrown away with it; a date that is reached on the way would end it.
    params.not_before = date_time_ymd(2020, 1, 1);
    params.not_after = date_time_ymd(2120, 1, 1);
    Ok(params)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_file_is_taken_apart_as_it_was_put_together() {
        let dir = std::env::temp_dir().join(format!("trestle-credentials-{}", std::process::id()));
        make(&dir, &["head.example", "127.0.0.1"]).unwrap();
        let [head, join] =
            ["head.pem", "join.pem"].map(|name| Credentials::read(dir.join(name).to_str().unwrap()).unwrap());
        assert_eq!(head.authority, join.authority);
        assert!(head.certificate != join.certificate && head.key != join.key);
        let again = make(&dir, &["other"]).unwrap_err().to_string();
        assert!(again.contains("head.pem"), "nothing is overwritten: {again}");
        for name in ["head.pem", "join.pem"] {
            use std::os::unix::fs::MetadataExt;
            assert_eq!(fs::metadata(dir.join(name)).unwrap().mode() & 0o777, 0o600);
        }
        fs::write(dir.join("half.pem"), &head.certificate).unwrap();
        let half = Credentials::read(dir.join("half.pem").to_str().unwrap()).unwrap_err().to_string();
        assert!(half.contains("accepted: a certificate"), "{half}");
        fs::remove_dir_all(dir).unwrap();
    }
}
