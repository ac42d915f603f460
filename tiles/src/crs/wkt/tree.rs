//! Well-known text as a tree: `KEYWORD["text", 1.5, AXIS, KEYWORD[...]]`, with either bracket.
//!
//! Safe on untrusted text: its length, its depth and the count of its nodes are limited.

/// No definition is longer, in bytes.
pub const MAX_BYTES: usize = 1 << 16;
/// Nodes inside nodes.
const MAX_DEPTH: usize = 32;
/// Nodes and values in all.
const MAX_VALUES: usize = 4096;

/// `KEYWORD[...]`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Node {
    /// In upper case.
    pub keyword: String,
    pub values: Vec<Value>,
}

/// What stands between commas.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Value {
    Text(String),
    Number(f64),
    /// A word without brackets, such as `north`.
    Word(String),
    Node(Node),
}

impl Node {
    /// Reads one node and nothing after it.
    ///
    /// # Errors
    /// A sentence that says at which byte, what was found, and what is allowed.
    pub fn parse(wkt: &str) -> Result<Node, String> {
        if wkt.len() > MAX_BYTES {
            let found = wkt.len();
            return Err(format!(
                "{found} bytes of WKT, at most {MAX_BYTES} are allowed"
            ));
        }
        let mut reader = Reader {
            text: wkt,
            at: 0,
            values: 0,
        };
        let value = reader.value(0)?;
        reader.skip_space();
        match value {
            Value::Node(_) if reader.at < wkt.len() => Err(reader.unexpected("the end")),
            Value::Node(node) => Ok(node),
            _ => Err("no KEYWORD[...] in the WKT".into()),
        }
    }

    /// The first text, by which nodes are named.
    pub fn name(&self) -> &str {
        match self.values.first() {
            Some(Value::Text(text)) => text,
            _ => "",
        }
    }

    /// The numbers that are its own.
    pub fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        self.values.iter().filter_map(|value| match value {
            Value::Number(number) => Some(*number),
            _ => None,
        })
    }

    /// Its nodes.
    pub fn nodes(&self) -> impl Iterator<Item = &Node> + '_ {
        self.values.iter().filter_map(|value| match value {
            Value::Node(node) => Some(node),
            _ => None,
        })
    }

    /// The first of its nodes with one of these keywords.
    pub fn find(&self, keywords: &[&str]) -> Option<&Node> {
        self.nodes()
            .find(|node| keywords.contains(&node.keyword.as_str()))
    }

    /// The code of an authority: `AUTHORITY["EPSG","4326"]` or `ID["EPSG",4326]`.
    pub fn epsg(&self) -> Option<u16> {
        let id = self.find(&["AUTHORITY", "ID"])?;
        if !id.name().eq_ignore_ascii_case("EPSG") {
            return None;
        }
        match id.values.get(1)? {
            Value::Text(code) | Value::Word(code) => code.trim().parse().ok(),
            Value::Number(code) => {
                Some(*code as u16).filter(|short| f64::from(*short) == *code && *short > 0)
            }
            Value::Node(_) => None,
        }
    }
}

struct Reader<'a> {
    text: &'a str,
    at: usize,
    values: usize,
}

impl Reader<'_> {
    fn value(&mut self, depth: usize) -> Result<Value, String> {
        self.values += 1;
        if self.values > MAX_VALUES || depth > MAX_DEPTH {
            return Err(format!(
                "WKT too deep or too long at byte {}: at most {MAX_DEPTH} nodes in each other and \
                 {MAX_VALUES} values are allowed",
                self.at
            ));
        }
        self.skip_space();
        match self.peek() {
            Some(b'"') => self.quoted().map(Value::Text),
            Some(b'+' | b'-' | b'.' | b'0'..=b'9') => self.number().map(Value::Number),
            Some(c) if c.is_ascii_alphabetic() => self.word_or_node(depth),
            _ => Err(self.unexpected("a value")),
        }
    }

    fn word_or_node(&mut self, depth: usize) -> Result<Value, String> {
        let word = self.take(|c| c.is_ascii_alphanumeric() || c == b'_');
        let word = word.to_owned();
        self.skip_space();
        let close = match self.peek() {
            Some(b'[') => b']',
            Some(b'(') => b')',
            _ => return Ok(Value::Word(word)),
        };
        self.at += 1;
        let mut values = Vec::new();
        loop {
            values.push(self.value(depth + 1)?);
            self.skip_space();
            match self.peek() {
                Some(b',') => self.at += 1,
                Some(c) if c == close => break,
                _ => return Err(self.unexpected("a comma or a closing bracket")),
            }
        }
        self.at += 1;
        Ok(Value::Node(Node {
            keyword: word.to_ascii_uppercase(),
            values,
        }))
    }

    /// Text between quotes, where two quotes stand for one.
    fn quoted(&mut self) -> Result<String, String> {
        let mut text = String::new();
        loop {
            self.at += 1;
            text.push_str(self.take(|c| c != b'"'));
            if self.peek().is_none() {
                return Err(self.unexpected("a closing quote"));
            }
            self.at += 1;
            if self.peek() != Some(b'"') {
                return Ok(text);
            }
            text.push('"');
        }
    }

    fn number(&mut self) -> Result<f64, String> {
        let start = self.at;
        let digits = self.take(|c| c.is_ascii_alphanumeric() || b"+-.".contains(&c));
        let number = digits.parse().ok().filter(|v: &f64| v.is_finite());
        number.ok_or_else(|| format!("{digits:?} at byte {start} of the WKT, expected a number"))
    }

    fn take(&mut self, belongs: impl Fn(u8) -> bool) -> &str {
        let rest = &self.text[self.at..];
        let length = rest.bytes().take_while(|c| belongs(*c)).count();
        self.at += length;
        &rest[..length]
    }

    fn peek(&self) -> Option<u8> {
        self.text.as_bytes().get(self.at).copied()
    }

    fn skip_space(&mut self) {
        self.take(|c| c.is_ascii_whitespace());
    }

    fn unexpected(&self, expected: &str) -> String {
        let rest = self.text.as_bytes().get(self.at..).unwrap_or_default();
        let found = match &rest[..rest.len().min(12)] {
            [] => "the end".to_string(),
            some => format!("\"{}\"", some.escape_ascii()),
        };
        format!(
            "{found} at byte {} of the WKT, expected {expected}",
            self.at
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_texts_numbers_and_words_are_told_apart() {
        let node =
            Node::parse("axis(\"say \"\"north\"\"\", NORTH, UNIT[ \"m\" , -1.5e1 ])").unwrap();
        assert_eq!(node.keyword, "AXIS");
        assert_eq!(node.name(), "say \"north\"");
        assert_eq!(node.values[1], Value::Word("NORTH".into()));
        assert_eq!(node.find(&["UNIT"]).unwrap().numbers().next(), Some(-15.0));
    }

    #[test]
    fn deep_long_and_broken_text_is_refused_with_its_place() {
        let deep = "A[".repeat(30_000);
        let wide = format!("A[{}1]", "1,".repeat(20_000));
        let huge = format!("A[\"{}\"]", "x".repeat(MAX_BYTES));
        for (text, says) in [
            (deep.as_str(), "too deep"),
            (&wide, "too long"),
            (&huge, "bytes of WKT"),
            ("", "the end at byte 0"),
            ("A", "no KEYWORD"),
            ("A[\"b", "closing quote"),
            ("A[1e999]", "expected a number"),
            ("A[1] x", "expected the end"),
            ("A[1)", "closing bracket"),
            ("A[\u{e9}]", "expected a value"),
        ] {
            let error = Node::parse(text).unwrap_err();
            assert!(error.contains(says), "{error}");
        }
    }

    #[test]
    fn an_authoritys_code_is_read_in_both_spellings() {
        let code = |text| Node::parse(text).unwrap().epsg();
        assert_eq!(code("A[\"\",AUTHORITY[\"EPSG\",\"4326\"]]"), Some(4326));
        assert_eq!(code("A[\"\",ID[\"EPSG\",4326]]"), Some(4326));
        assert_eq!(code("A[\"\",ID[\"EPSG\",4326.5]]"), None);
        assert_eq!(code("A[\"\",AUTHORITY[\"ESRI\",\"102100\"]]"), None);
    }
}
