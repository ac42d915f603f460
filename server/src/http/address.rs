//! The addresses of a dataset's bytes, taken apart by hand: they are asked for a thousand times
//! as often as all others.

use crate::catalog::percent_decoded;
use escarp_proto::geometry::PageId;
use std::borrow::Cow;

/// A dataset's bytes, as an address names them.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Address<'a> {
    /// The dataset.
    pub name: Cow<'a, str>,
    /// The id of a generation; without it, the current one is meant.
    pub generation: Option<&'a str>,
    pub what: What<'a>,
}

/// What of a dataset an address names.
#[derive(Debug, PartialEq, Eq, Clone, Copy)]
pub(super) enum What<'a> {
    Manifest,
    /// The record of a page.
    Page(Place<'a>),
    /// The family below a page.
    Pack(Place<'a>),
}

/// `LEVEL/X/Y`, which may be no page's.
#[derive(Debug, PartialEq, Eq, Clone, Copy)]
pub(super) struct Place<'a>(pub [&'a str; 3]);

impl<'a> Address<'a> {
    /// Takes a path apart. `None` if it is none of these addresses.
    pub fn parse(path: &'a str) -> Option<Address<'a>> {
        let mut parts = [""; 6];
        let mut count = 0;
        for part in path.strip_prefix('/')?.split('/') {
            *parts.get_mut(count)? = part;
            count += 1;
        }
        let (generation, rest) = match &parts[1..count] {
            rest @ (["manifest"] | ["page" | "pack", _, _, _]) => (None, rest),
            [generation, rest @ ..] => (Some(*generation), rest),
            [] => return None,
        };
        let what = match *rest {
            ["manifest"] => What::Manifest,
            ["page", level, x, y] => What::Page(Place([level, x, y])),
            ["pack", level, x, y] => What::Pack(Place([level, x, y])),
            _ => return None,
        };
        Some(Address {
            name: percent_decoded(parts[0])?,
            generation,
            what,
        })
    }
}

impl Place<'_> {
    /// The page, if there can be one.
    pub fn page(&self) -> Option<PageId> {
        let [level, x, y] = self.0.map(number);
        PageId::new(level?.try_into().ok()?, x?, y?)
    }
}

/// A number as it is written in one way only: what has two addresses is kept twice by caches.
fn number(digits: &str) -> Option<u32> {
    let plain = digits == "0" || !digits.starts_with(['0', '+']);
    digits.parse().ok().filter(|_| plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_taken_apart() {
        let place = Place(["4", "1", "2"]);
        let table = [
            ("/moon/manifest", "moon", None, What::Manifest),
            ("/moon/3-0/manifest", "moon", Some("3-0"), What::Manifest),
            ("/moon/page/4/1/2", "moon", None, What::Page(place)),
            ("/moon/pack/4/1/2", "moon", None, What::Pack(place)),
            (
                "/moon/3-0/page/4/1/2",
                "moon",
                Some("3-0"),
                What::Page(place),
            ),
            (
                "/moon/3-0/pack/4/1/2",
                "moon",
                Some("3-0"),
                What::Pack(place),
            ),
            (
                "/page/page/page/4/1/2",
                "page",
                Some("page"),
                What::Page(place),
            ),
            ("/Gr%C3%BC/manifest", "Grü", None, What::Manifest),
        ];
        for (path, name, generation, what) in table {
            let right = Address {
                name: name.into(),
                generation,
                what,
            };
            assert_eq!(Address::parse(path), Some(right), "{path}");
        }
        for path in [
            "",
            "/",
            "/moon",
            "/moon/current",
            "/moon/3-0",
            "/moon/3-0/page/4/1",
            "/moon/page/4/1/2/3/4",
            "/moon/3-0/page/4/1/2/3",
            "/moon/3-0/tile/4/1/2",
            "/moon/manifest/",
            "moon/manifest",
            "/%ff/manifest",
            "*",
        ] {
            assert_eq!(Address::parse(path), None, "{path}");
        }
    }

    #[test]
    fn a_page_has_one_address() {
        let page = |parts| Place(parts).page();
        assert_eq!(page(["4", "10", "0"]), PageId::new(4, 10, 0));
        for wrong in [
            ["04", "1", "0"],
            ["4", "+1", "0"],
            ["4", "1", "00"],
            ["4", "-1", "0"],
            ["4", "", "0"],
            ["3", "1", "0"],
            ["260", "1", "0"],
            ["4", "16", "0"],
            ["4", "4294967297", "0"],
        ] {
            assert_eq!(page(wrong), None, "{wrong:?}");
        }
    }
}
