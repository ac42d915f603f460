//! Vertical references: what heights are above. They are recorded and shown; heights are never
//! transformed from one to another.

use super::wkt::tree::Node;

/// Vertical CRSs that elevation data comes in, by EPSG code.
const KNOWN: &[(u16, &str)] = &[
    (3855, "EGM2008 height"),
    (3886, "Fao 1979 height"),
    (3900, "N2000 height"),
    (4440, "NZVD2009 height"),
    (4979, "ellipsoidal height on WGS 84"),
    (5030, "ellipsoidal height on WGS 84"),
    (5193, "Incheon height"),
    (5195, "Trieste height"),
    (5214, "Genoa height"),
    (5336, "Black Sea height"),
    (5600, "NGPF height"),
    (5601, "IGN 1966 height"),
    (5603, "IGN 1988 SB height"),
    (5613, "RH2000 height"),
    (5621, "EVRF2007 height"),
    (5701, "ODN height"),
    (5702, "NGVD29 height (ftUS)"),
    (5703, "NAVD88 height"),
    (5705, "Baltic 1977 height"),
    (5709, "NAP height"),
    (5710, "Ostend height"),
    (5711, "AHD height"),
    (5714, "mean sea level height"),
    (5715, "mean sea level depth"),
    (5716, "Piraeus height"),
    (5720, "NGF-IGN69 height"),
    (5723, "JSLD69 height"),
    (5728, "LN02 height"),
    (5729, "LHN95 height"),
    (5773, "EGM96 height"),
    (5776, "NN54 height"),
    (5783, "DHHN92 height"),
    (5798, "EGM84 height"),
    (5941, "NN2000 height"),
    (6360, "NAVD88 height (ftUS)"),
    (6647, "CGVD2013(CGG2013) height"),
    (6695, "JGD2011 (vertical) height"),
    (7837, "DHHN2016 height"),
    (7839, "NZVD2016 height"),
    (8228, "NAVD88 height (ft)"),
    (9389, "EVRF2019 height"),
];

/// Names longer than this are cut.
const MAX_NAME: usize = 200;

/// A vertical CRS by its code, with its name where it is known.
pub fn from_code(code: u16) -> String {
    match KNOWN.iter().find(|(known, _)| *known == code) {
        Some((_, name)) => format!("{name} (EPSG:{code})"),
        None => format!("EPSG:{code}"),
    }
}

/// A vertical reference as a user or a citation states it; `None` if it says nothing.
pub fn from_text(text: &str) -> Option<String> {
    let kept: String = text.chars().filter(|c| !c.is_control()).collect();
    let kept: String = kept.trim().chars().take(MAX_NAME).collect();
    (!kept.is_empty()).then_some(kept)
}

/// The vertical reference of a WKT: its `VERT_CS`, `VERTCRS` or `VERTCS`, or that of an
/// ellipsoid's three dimensions; `None` where it has none, or is no WKT.
pub fn from_wkt(wkt: &str) -> Option<String> {
    let root = Node::parse(wkt).ok()?;
    if root.epsg() == Some(4979) {
        return Some(from_code(4979));
    }
    let node = vertical_node(&root)?;
    match node.epsg() {
        Some(code) if KNOWN.iter().any(|(known, _)| *known == code) => Some(from_code(code)),
        Some(code) => from_text(&format!("{} (EPSG:{code})", node.name())),
        None => from_text(node.name()),
    }
}

/// Metres of the vertical unit of a WKT; `None` where it has none.
pub fn metres_of_wkt(wkt: &str) -> Option<f64> {
    let root = Node::parse(wkt).ok()?;
    let node = vertical_node(&root)?;
    let unit = |node: &Node| node.find(&["UNIT", "LENGTHUNIT"]).cloned();
    let unit = unit(node).or_else(|| unit(node.find(&["AXIS"])?))?;
    let metres = unit.numbers().next();
    metres.filter(|m| m.is_finite() && *m > 0.0)
}

fn vertical_node(root: &Node) -> Option<&Node> {
    const VERTICAL: [&str; 5] = ["VERT_CS", "VERTCS", "VERTCRS", "VERTICALCRS", "SOURCECRS"];
    let mut node = root;
    // A compound CRS holds it, and a bound one holds that; depth is limited by the parser.
    loop {
        match node.keyword.as_str() {
            "VERT_CS" | "VERTCS" | "VERTCRS" | "VERTICALCRS" => return Some(node),
            "COMPD_CS" | "COMPOUNDCRS" | "BOUNDCRS" | "SOURCECRS" => {
                let inner = node.find(&VERTICAL);
                node = inner.or_else(|| node.find(&["COMPD_CS", "COMPOUNDCRS", "BOUNDCRS"]))?;
            }
            // Esri writes VERTCS inside the horizontal one.
            _ => return node.find(&["VERTCS", "VERT_CS"]),
        }
    }
}
