//! What an ICC profile calls itself. Profiles are not applied; files that carry another one than sRGB's are told of.

/// Signature of the tag that holds the profile's description.
const DESCRIPTION: &[u8] = b"desc";

/// The profile's description; `None` if it has none that can be read.
pub(super) fn description(profile: &[u8]) -> Option<String> {
    let word = |at: usize| -> Option<usize> {
        let bytes = profile.get(at..)?.first_chunk::<4>()?;
        Some(u32::from_be_bytes(*bytes) as usize)
    };
    // 128 bytes of header, then a count and as many records of signature, offset and size.
    let count = word(128)?.min(profile.len() / 12);
    let record = (0..count).map(|i| 132 + 12 * i);
    let at = record
        .into_iter()
        .find(|at| profile.get(*at..at + 4) == Some(DESCRIPTION))?;
    let offset = word(at + 4)?;
    let text = match profile.get(offset..offset.checked_add(4)?)? {
        // Version 2: a length and as many ASCII bytes.
        b"desc" => {
            let length = word(offset + 8)?;
            let bytes = profile.get(offset + 12..(offset + 12).checked_add(length)?)?;
            String::from_utf8_lossy(bytes).into_owned()
        }
        // Version 4: names in several languages, UTF-16; the first will do.
        b"mluc" => {
            let (length, start) = (word(offset + 20)?, word(offset + 24)?);
            let start = offset.checked_add(start)?;
            let bytes = profile.get(start..start.checked_add(length)?)?;
            let units = bytes
                .as_chunks::<2>()
                .0
                .iter()
                .map(|b| u16::from_be_bytes(*b));
            String::from_utf16_lossy(&units.collect::<Vec<_>>())
        }
        _ => return None,
    };
    let text: String = text.chars().filter(|c| !c.is_control()).take(80).collect();
    let text = text.trim();
    (!text.is_empty()).then(|| text.to_owned())
}

/// What to tell of a profile: nothing of sRGB's in any of its spellings.
pub(super) fn warning(profile: &[u8]) -> Option<String> {
    let name = description(profile).unwrap_or_else(|| "without a name".to_owned());
    let plain: String = name
        .chars()
        .filter(char::is_ascii_alphanumeric)
        .collect::<String>()
        .to_lowercase();
    // "c2" is the smallest sRGB profile that there is, "Gray Gamma 2.2" and its like are as near as 8 bits tell.
    let srgb = plain.contains("srgb") || plain == "c2" || plain.contains("gamma22");
    (!srgb).then(|| format!("ICC profile `{name}`: not applied, colours are taken as sRGB"))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A profile with nothing but a description.
    pub(in crate::image) fn profile(name: &str, version_4: bool) -> Vec<u8> {
        let mut bytes = vec![0; 128];
        let mut text = Vec::new();
        if version_4 {
            let name: Vec<u8> = name.encode_utf16().flat_map(u16::to_be_bytes).collect();
            text.extend(b"mluc\0\0\0\0\0\0\0\x01\0\0\0\x0cenUS");
            text.extend((name.len() as u32).to_be_bytes());
            text.extend(28_u32.to_be_bytes());
            text.extend(name);
        } else {
            text.extend(b"desc\0\0\0\0");
            text.extend((name.len() as u32 + 1).to_be_bytes());
            text.extend(name.bytes().chain([0]));
        }
        bytes.extend(1_u32.to_be_bytes());
        bytes.extend(b"desc");
        bytes.extend(144_u32.to_be_bytes());
        bytes.extend((text.len() as u32).to_be_bytes());
        bytes.extend(text);
        bytes
    }

    #[test]
    fn names_of_both_versions() {
        for version_4 in [false, true] {
            let p3 = profile("Display P3", version_4);
            assert_eq!(description(&p3).as_deref(), Some("Display P3"));
            assert!(warning(&p3).expect("a warning").contains("`Display P3`"));
            assert_eq!(warning(&profile("sRGB IEC61966-2.1", version_4)), None);
            for cut in 0..p3.len() {
                // Never a panic, whatever is missing.
                let _ = description(&p3[..cut]);
            }
        }
        assert!(
            warning(b"nothing")
                .expect("a warning")
                .contains("without a name")
        );
    }
}
