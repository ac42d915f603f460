//! What a plot is made of, before it is SVG or PNG.

/// A colour by its use: what it looks like follows from the page's scheme.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ink {
    /// Titles and labels.
    Text,
    /// What is said by the way.
    Muted,
    /// Lines of the grid.
    Grid,
    /// The ground.
    Paper,
    /// The curve with this number.
    Series(usize),
}

/// `(name of the CSS variable, light, dark)`; the series are told apart by people who do not see
/// red or green, too (M. Okabe, K. Ito, "Color Universal Design", 2008), and by grey values.
const SERIES: [(&str, u32, u32); 7] = [
    ("--s0", 0x0072b2, 0x4aa8e0),
    ("--s1", 0xd55e00, 0xff8a3c),
    ("--s2", 0x009e73, 0x2fc79b),
    ("--s3", 0xb8548d, 0xe597c2),
    ("--s4", 0xb98500, 0xf0c04a),
    ("--s5", 0x3b3b3b, 0xc9c9c9),
    ("--s6", 0x6a51a3, 0xa999dd),
];
const OTHERS: [(&str, u32, u32); 4] = [
    ("--ink", 0x1c2126, 0xe7ebef),
    ("--muted", 0x5b6570, 0x9aa5b1),
    ("--grid", 0xdde2e7, 0x313942),
    ("--paper", 0xffffff, 0x14181d),
];

impl Ink {
    fn entry(self) -> (&'static str, u32, u32) {
        match self {
            Ink::Text => OTHERS[0],
            Ink::Muted => OTHERS[1],
            Ink::Grid => OTHERS[2],
            Ink::Paper => OTHERS[3],
            Ink::Series(number) => SERIES[number % SERIES.len()],
        }
    }

    /// The CSS variable that has it.
    pub fn variable(self) -> &'static str {
        self.entry().0
    }

    /// Red, green and blue on white.
    pub fn light(self) -> [u8; 3] {
        rgb(self.entry().1)
    }

    /// All of them as the declarations of CSS variables.
    pub fn declarations(dark: bool) -> String {
        let entries = OTHERS.iter().chain(&SERIES);
        entries
            .map(|&(name, on_white, on_black)| {
                let colour = if dark { on_black } else { on_white };
                format!("{name}:#{colour:06x};")
            })
            .collect()
    }
}

const fn rgb(colour: u32) -> [u8; 3] {
    let [_, r, g, b] = colour.to_be_bytes();
    [r, g, b]
}

/// Where a text begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    /// At its left.
    Start,
    /// In its middle.
    Middle,
    /// At its right.
    End,
}

/// One thing that is drawn, coordinates in pixels from the upper left.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// Joined points.
    Line {
        /// The points.
        points: Vec<[f64; 2]>,
        /// Colour.
        ink: Ink,
        /// Width.
        width: f64,
        /// Lengths of dashes and gaps; solid if empty.
        dash: &'static [f64],
    },
    /// A filled polygon.
    Fill {
        /// Its corners.
        points: Vec<[f64; 2]>,
        /// Colour.
        ink: Ink,
        /// Between 0 and 1.
        opacity: f64,
    },
    /// A line of text.
    Text {
        /// Where its baseline begins, is in the middle, or ends.
        at: [f64; 2],
        /// What it says.
        text: String,
        /// Height of its type.
        size: f64,
        /// What `at` is.
        anchor: Anchor,
        /// Colour.
        ink: Ink,
        /// Heavier.
        bold: bool,
        /// Turned to read upwards.
        upwards: bool,
    },
}

/// A picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawing {
    /// Width and height.
    pub size: [f64; 2],
    /// What it shows, for those who do not see it.
    pub title: String,
    /// The lowest first.
    pub shapes: Vec<Shape>,
}

impl Drawing {
    /// An empty one.
    pub fn new(size: [f64; 2], title: &str) -> Drawing {
        Drawing {
            size,
            title: title.into(),
            shapes: Vec::new(),
        }
    }

    /// Adds a line.
    pub fn line(&mut self, points: Vec<[f64; 2]>, ink: Ink, width: f64, dash: &'static [f64]) {
        self.shapes.push(Shape::Line {
            points,
            ink,
            width,
            dash,
        });
    }

    /// Adds a filled rectangle.
    pub fn rectangle(&mut self, [x0, y0]: [f64; 2], [x1, y1]: [f64; 2], ink: Ink, opacity: f64) {
        self.shapes.push(Shape::Fill {
            points: vec![[x0, y0], [x1, y0], [x1, y1], [x0, y1]],
            ink,
            opacity,
        });
    }

    /// Adds a text.
    pub fn text(&mut self, at: [f64; 2], text: &str, size: f64, anchor: Anchor, ink: Ink) {
        self.shapes.push(Shape::Text {
            at,
            text: text.into(),
            size,
            anchor,
            ink,
            bold: false,
            upwards: false,
        });
    }

    /// Adds a mark around a point: every series has another form.
    pub fn mark(&mut self, [x, y]: [f64; 2], series: usize, radius: f64) {
        let around = |corners: usize, turn: f64, r: f64| -> Vec<[f64; 2]> {
            let angle = |i: usize| (i as f64 / corners as f64 + turn) * std::f64::consts::TAU;
            (0..corners)
                .map(|i| [x + r * angle(i).cos(), y + r * angle(i).sin()])
                .collect()
        };
        let points = match series % 5 {
            0 => around(24, 0.0, radius),
            1 => around(4, 0.125, radius * 1.25),
            2 => around(3, -0.25, radius * 1.35),
            3 => around(4, 0.0, radius * 1.3),
            _ => around(3, 0.25, radius * 1.35),
        };
        self.shapes.push(Shape::Fill {
            points,
            ink: Ink::Series(series),
            opacity: 1.0,
        });
    }
}
