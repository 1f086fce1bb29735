//! Statements of OBJ and MTL files: lines of bytes in no particular encoding, put together where they continue.

use std::borrow::Cow;

/// A line that says something.
pub struct Statement<'a> {
    /// Number of its first line, from 1.
    pub line: usize,
    /// Its first word.
    pub keyword: Cow<'a, [u8]>,
    /// What follows, without white space around it.
    pub rest: Cow<'a, [u8]>,
}

/// The statements of a file. Comments, empty lines and a byte order mark are left out; a `\` at the end of a line joins
/// it with the next.
pub fn statements(bytes: &[u8]) -> impl Iterator<Item = Statement<'_>> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    // Files of the old Mac OS have no other line end.
    let end = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
    let mut lines = bytes.split(move |&b| b == end).map(<[u8]>::trim_ascii);
    let mut number = 0;
    std::iter::from_fn(move || {
        loop {
            number += 1;
            let line = number;
            let mut text = Cow::Borrowed(lines.next()?);
            if text.is_empty() || text.starts_with(b"#") {
                continue;
            }
            while continues(&text) {
                let text = text.to_mut();
                text.pop();
                let Some(next) = lines.next() else { break };
                number += 1;
                text.push(b' ');
                text.extend(next);
            }
            let key = text.iter().take_while(|b| !b.is_ascii_whitespace()).count();
            let (keyword, rest) = match text {
                Cow::Borrowed(t) => (t[..key].into(), t[key..].trim_ascii().into()),
                Cow::Owned(t) => (
                    t[..key].to_vec().into(),
                    t[key..].trim_ascii().to_vec().into(),
                ),
            };
            return Some(Statement {
                line,
                keyword,
                rest,
            });
        }
    })
}

/// Whether the line goes on in the next. In GBK and Shift JIS the second byte of a letter may be a `\`.
fn continues(line: &[u8]) -> bool {
    matches!(line, [b'\\'] | [.., 0..0x80, b'\\'])
}

/// The words of a statement of numbers up to a comment, but for the `1.#QNAN` of old C programs.
pub fn words(rest: &[u8]) -> impl Iterator<Item = &[u8]> {
    let begins = |i: &usize| rest[*i] == b'#' && (*i == 0 || rest[i - 1] != b'.');
    let end = (0..rest.len()).find(begins).unwrap_or(rest.len());
    rest[..end]
        .split(u8::is_ascii_whitespace)
        .filter(|w| !w.is_empty())
}

/// A statement's one name, which may hold spaces and be in quotes.
pub fn name(rest: &[u8]) -> &[u8] {
    let quoted = rest.strip_prefix(b"\"").and_then(|r| r.strip_suffix(b"\""));
    quoted.unwrap_or(rest)
}

/// A name without the comment behind it; names may hold `#`, so this is for those that are not found as they are.
pub fn uncommented(rest: &[u8]) -> &[u8] {
    let comment = rest.windows(2).position(|w| {
        let [before, mark] = w else { return false };
        before.is_ascii_whitespace() && *mark == b'#'
    });
    name(rest[..comment.unwrap_or(rest.len())].trim_ascii())
}

/// A number, as C programs print them: without a value it is not finite.
pub fn number(word: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    text.parse().ok().or_else(|| {
        let text = text.to_ascii_lowercase();
        let nothing = ["nan(", "1.#ind", "1.#inf", "1.#qnan", "1.#snan"];
        let digits = text.trim_start_matches(['-', '+']);
        let found = nothing.iter().any(|n| digits.starts_with(n));
        found.then_some(f64::NAN)
    })
}

/// For people.
pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_joined_and_comments_left_out() {
        let file = b"\xef\xbb\xbfmtllib a b.mtl \r\n# C:\\models\\\r\n\tf 1\t2 \\\r\n 3 # side\r\n\r\nusemtl\r\nv 1";
        let all: Vec<_> = statements(file)
            .map(|s| (s.line, text(&s.keyword), text(&s.rest)))
            .collect();
        let expected = [
            (1, "mtllib", "a b.mtl"),
            (3, "f", "1\t2  3 # side"),
            (6, "usemtl", ""),
            (7, "v", "1"),
        ];
        let expected = expected.map(|(n, k, r)| (n, k.to_owned(), r.to_owned()));
        assert_eq!(all, expected);
        assert_eq!(
            words(b"1\t2   3# side").collect::<Vec<_>>(),
            [b"1", b"2", b"3"]
        );
        assert_eq!(statements(b"v 1\rv 2\r").count(), 2);
        assert_eq!(statements(b"f 1 2 \\").count(), 1);
        assert_eq!(statements(b"usemtl \x95\\\nf 1 2 3").count(), 2);
    }

    #[test]
    fn names_keep_spaces_and_lose_quotes_and_comments() {
        assert_eq!(name(b"\"my lib.mtl\""), b"my lib.mtl");
        assert_eq!(uncommented(b"red #2 # side"), b"red");
        assert_eq!(uncommented(b"red#2"), b"red#2");
        assert_eq!(number(b"-1.5e2"), Some(-150.0));
        assert!(number(b"-nan(ind)").is_some_and(f64::is_nan));
        assert!(number(b"1.#QNAN").is_some_and(f64::is_nan));
        assert_eq!(number(b"1,5"), None);
    }
}
