//! Map projections by their names in WKT, GeoTIFF and PROJ: one table for reading and writing.
//!
//! After OGC 19-008r4, "OGC GeoTIFF Standard" (2019), annex C; IOGP, "Coordinate Conversions and
//! Transformations including Formulas", Guidance Note 7-2; and the names that GDAL and Esri write.

/// What a parameter of a projection means, whatever a format calls it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Role {
    /// Latitude of origin, of the false origin, or of the centre, degrees.
    Latitude,
    /// Central meridian or longitude of the centre, degrees.
    Longitude,
    /// Standard parallel, the first if there are two, degrees.
    Parallel1,
    /// The second standard parallel, degrees.
    Parallel2,
    /// Scale factor at the origin or on the initial line.
    Scale,
    /// Easting of the origin, in metres once it is in [`Conversion`].
    Easting,
    /// Northing of the origin, as [`Role::Easting`].
    Northing,
    /// Azimuth of the initial line, degrees.
    Azimuth,
    /// Angle from the rectified to the skew grid, degrees.
    GridAngle,
}

impl Role {
    /// A parameter of WKT by its name, without regard to case, spaces and underscores.
    pub fn of_wkt(name: &str) -> Option<Role> {
        let name = plain(name);
        Some(match name.as_str() {
            "latitudeoforigin"
            | "latitudeofcenter"
            | "latitudeofcentre"
            | "latitudeofnaturalorigin"
            | "latitudeoffalseorigin"
            | "latitudeofprojectioncentre"
            | "centralparallel" => Role::Latitude,
            "centralmeridian"
            | "longitudeofcenter"
            | "longitudeofcentre"
            | "longitudeoforigin"
            | "longitudeofnaturalorigin"
            | "longitudeoffalseorigin"
            | "longitudeofprojectioncentre"
            | "straightverticallongitudefrompole" => Role::Longitude,
            "standardparallel1"
            | "latitudeof1ststandardparallel"
            | "latitudeofstandardparallel"
            | "standardparallel" => Role::Parallel1,
            "standardparallel2" | "latitudeof2ndstandardparallel" => Role::Parallel2,
            "scalefactor"
            | "scalefactoratnaturalorigin"
            | "scalefactoratprojectioncentre"
            | "scalefactoroninitialline"
            | "scalefactoratfalseorigin" => Role::Scale,
            "falseeasting" | "eastingatfalseorigin" | "eastingatprojectioncentre" => Role::Easting,
            "falsenorthing" | "northingatfalseorigin" | "northingatprojectioncentre" => {
                Role::Northing
            }
            "azimuth" | "azimuthofinitialline" | "azimuthatprojectioncentre" => Role::Azimuth,
            "rectifiedgridangle" | "anglefromrectifiedtoskewgrid" | "xyplanerotation" => {
                Role::GridAngle
            }
            _ => return None,
        })
    }

    /// A GeoKey that holds a parameter.
    pub fn of_geokey(key: u16) -> Option<Role> {
        Some(match key {
            3081 | 3085 | 3089 => Role::Latitude,
            3080 | 3084 | 3088 | 3095 => Role::Longitude,
            3078 => Role::Parallel1,
            3079 => Role::Parallel2,
            3092 | 3093 => Role::Scale,
            3082 | 3086 | 3090 => Role::Easting,
            3083 | 3087 | 3091 => Role::Northing,
            3094 => Role::Azimuth,
            3096 => Role::GridAngle,
            _ => return None,
        })
    }

    /// Whether it is a length, and not an angle or a ratio.
    pub fn is_length(self) -> bool {
        matches!(self, Role::Easting | Role::Northing)
    }

    /// Whether it is an angle.
    pub fn is_angle(self) -> bool {
        !self.is_length() && self != Role::Scale
    }
}

/// A projection method.
#[derive(Debug, PartialEq)]
pub(crate) struct Method {
    /// PROJ's name.
    proj: &'static str,
    /// GeoTIFF's ProjCoordTrans code, 0 where it has none.
    pub geotiff: u16,
    /// Names in WKT, plain.
    names: &'static [&'static str],
    /// PROJ parameter, what it means, and the GeoKey it is written as.
    parameters: &'static [(&'static str, Role, u16)],
}

use Role::{
    Azimuth as A, Easting as E, GridAngle as G, Latitude as La, Longitude as Lo, Northing as N,
    Parallel1 as P1, Parallel2 as P2, Scale as K,
};

const NATURAL: &[(&str, Role, u16)] = &[
    ("lat_0", La, 3081),
    ("lon_0", Lo, 3080),
    ("k_0", K, 3092),
    ("x_0", E, 3082),
    ("y_0", N, 3083),
];
const CENTRED: &[(&str, Role, u16)] = &[
    ("lat_0", La, 3089),
    ("lon_0", Lo, 3088),
    ("x_0", E, 3082),
    ("y_0", N, 3083),
];
const FALSE_ORIGIN: &[(&str, Role, u16)] = &[
    ("lat_0", La, 3085),
    ("lon_0", Lo, 3084),
    ("lat_1", P1, 3078),
    ("lat_2", P2, 3079),
    ("k_0", K, 0),
    ("x_0", E, 3086),
    ("y_0", N, 3087),
];
const TWO_PARALLELS: &[(&str, Role, u16)] = &[
    ("lat_0", La, 3081),
    ("lon_0", Lo, 3080),
    ("lat_1", P1, 3078),
    ("lat_2", P2, 3079),
    ("x_0", E, 3082),
    ("y_0", N, 3083),
];
const WORLD: &[(&str, Role, u16)] = &[("lon_0", Lo, 3088), ("x_0", E, 3082), ("y_0", N, 3083)];
const OBLIQUE: &[(&str, Role, u16)] = &[
    ("lat_0", La, 3089),
    ("lonc", Lo, 3088),
    ("alpha", A, 3094),
    ("gamma", G, 3096),
    ("k_0", K, 3093),
    ("x_0", E, 3082),
    ("y_0", N, 3083),
];

/// GeoTIFF codes of methods that differ from another one of the same PROJ name.
const TWO_PARALLEL_LAMBERT: u16 = 8;
const ONE_PARALLEL_LAMBERT: u16 = 9;
const POLAR: u16 = 15;
const FROM_NATURAL_ORIGIN: u16 = 3;

/// The first method of a PROJ or GeoTIFF name is the one that is written.
const METHODS: &[Method] = &[
    Method {
        proj: "tmerc",
        geotiff: 1,
        names: &[
            "transversemercator",
            "gausskruger",
            "transversemercatorcomplex",
        ],
        parameters: NATURAL,
    },
    Method {
        proj: "merc",
        geotiff: 7,
        names: &[
            "mercator1sp",
            "mercatorvarianta",
            "mercator",
            "mercator2sp",
            "mercatorvariantb",
        ],
        parameters: &[
            ("lon_0", Lo, 3080),
            ("lat_ts", P1, 3078),
            ("k_0", K, 3092),
            ("x_0", E, 3082),
            ("y_0", N, 3083),
        ],
    },
    Method {
        proj: "lcc",
        geotiff: TWO_PARALLEL_LAMBERT,
        names: &[
            "lambertconformalconic2sp",
            "lambertconicconformal2sp",
            "lambertconformalconic",
        ],
        parameters: FALSE_ORIGIN,
    },
    Method {
        proj: "lcc",
        geotiff: ONE_PARALLEL_LAMBERT,
        names: &["lambertconformalconic1sp", "lambertconicconformal1sp"],
        parameters: NATURAL,
    },
    Method {
        proj: "aea",
        geotiff: 11,
        names: &["albersconicequalarea", "albersequalarea", "albers"],
        parameters: TWO_PARALLELS,
    },
    Method {
        proj: "laea",
        geotiff: 10,
        names: &[
            "lambertazimuthalequalarea",
            "lambertazimuthalequalareaspherical",
        ],
        parameters: CENTRED,
    },
    Method {
        proj: "aeqd",
        geotiff: 12,
        names: &["azimuthalequidistant", "modifiedazimuthalequidistant"],
        parameters: CENTRED,
    },
    Method {
        proj: "eqdc",
        geotiff: 13,
        names: &["equidistantconic"],
        parameters: TWO_PARALLELS,
    },
    Method {
        proj: "stere",
        geotiff: POLAR,
        names: &[
            "polarstereographic",
            "polarstereographicvarianta",
            "polarstereographicvariantb",
            "stereographicnorthpole",
            "stereographicsouthpole",
        ],
        parameters: &[
            ("lat_0", La, 3081),
            ("lat_ts", P1, 0),
            ("lon_0", Lo, 3095),
            ("k_0", K, 3092),
            ("x_0", E, 3082),
            ("y_0", N, 3083),
        ],
    },
    Method {
        proj: "stere",
        geotiff: 14,
        names: &["stereographic"],
        parameters: &[
            ("lat_0", La, 3089),
            ("lon_0", Lo, 3088),
            ("k_0", K, 3092),
            ("x_0", E, 3082),
            ("y_0", N, 3083),
        ],
    },
    Method {
        proj: "sterea",
        geotiff: 16,
        names: &["obliquestereographic", "doublestereographic"],
        parameters: NATURAL,
    },
    Method {
        proj: "eqc",
        geotiff: 17,
        names: &[
            "equirectangular",
            "equidistantcylindrical",
            "equidistantcylindricalspherical",
            "platecarree",
            "simplecylindrical",
        ],
        parameters: &[
            ("lat_ts", P1, 3078),
            ("lat_0", La, 3089),
            ("lon_0", Lo, 3088),
            ("x_0", E, 3082),
            ("y_0", N, 3083),
        ],
    },
    Method {
        proj: "cass",
        geotiff: 18,
        names: &["cassinisoldner", "cassini"],
        parameters: &[
            ("lat_0", La, 3081),
            ("lon_0", Lo, 3080),
            ("x_0", E, 3082),
            ("y_0", N, 3083),
        ],
    },
    Method {
        proj: "gnom",
        geotiff: 19,
        names: &["gnomonic"],
        parameters: CENTRED,
    },
    Method {
        proj: "mill",
        geotiff: 20,
        names: &["millercylindrical"],
        parameters: WORLD,
    },
    Method {
        proj: "ortho",
        geotiff: 21,
        names: &["orthographic"],
        parameters: CENTRED,
    },
    Method {
        proj: "poly",
        geotiff: 22,
        names: &["polyconic", "americanpolyconic"],
        parameters: &[
            ("lat_0", La, 3081),
            ("lon_0", Lo, 3080),
            ("x_0", E, 3082),
            ("y_0", N, 3083),
        ],
    },
    Method {
        proj: "robin",
        geotiff: 23,
        names: &["robinson"],
        parameters: WORLD,
    },
    Method {
        proj: "sinu",
        geotiff: 24,
        names: &["sinusoidal"],
        parameters: WORLD,
    },
    Method {
        proj: "cea",
        geotiff: 28,
        names: &["cylindricalequalarea", "lambertcylindricalequalarea"],
        parameters: &[
            ("lat_ts", P1, 3078),
            ("lon_0", Lo, 3080),
            ("x_0", E, 3082),
            ("y_0", N, 3083),
        ],
    },
    Method {
        proj: "omerc",
        geotiff: 9815,
        names: &[
            "hotineobliquemercatorazimuthcenter",
            "hotineobliquemercatorvariantb",
            "obliquemercator",
            "rectifiedskeworthomorphiccenter",
        ],
        parameters: OBLIQUE,
    },
    Method {
        proj: "omerc",
        geotiff: FROM_NATURAL_ORIGIN,
        names: &[
            "hotineobliquemercator",
            "hotineobliquemercatorvarianta",
            "hotineobliquemercatorazimuthnaturalorigin",
            "rectifiedskeworthomorphicnaturalorigin",
        ],
        parameters: OBLIQUE,
    },
    Method {
        proj: "moll",
        geotiff: 0,
        names: &["mollweide"],
        parameters: WORLD,
    },
    Method {
        proj: "eqearth",
        geotiff: 0,
        names: &["equalearth"],
        parameters: WORLD,
    },
];

/// Esri's and EPSG's Mercator of the web: a sphere's formulas on the ellipsoid's coordinates.
const WEB_MERCATOR: [&str; 3] = [
    "mercatorauxiliarysphere",
    "popularvisualisationpseudomercator",
    "popularvisualizationpseudomercator",
];

/// Whether a WKT method is the web's Mercator.
pub(crate) fn is_web_mercator(name: &str) -> bool {
    WEB_MERCATOR.contains(&plain(name).as_str())
}

/// A method with the values of its parameters: degrees, metres, ratios.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Conversion {
    pub method: &'static Method,
    pub values: Vec<(Role, f64)>,
}

impl Conversion {
    /// A method by its name in WKT.
    pub fn of_wkt(name: &str) -> Option<Conversion> {
        let name = plain(name);
        let method = METHODS.iter().find(|m| m.names.contains(&name.as_str()))?;
        Some(Self::new(method))
    }

    /// A method by its ProjCoordTrans code.
    pub fn of_geotiff(code: u16) -> Option<Conversion> {
        let method = METHODS.iter().find(|m| m.geotiff == code && code != 0)?;
        Some(Self::new(method))
    }

    /// Zone 1 to 60 of the universal transverse Mercator projection.
    pub fn utm(zone: u16, south: bool) -> Conversion {
        let values = vec![
            (Role::Latitude, 0.0),
            (Role::Longitude, f64::from(zone) * 6.0 - 183.0),
            (Role::Scale, 0.9996),
            (Role::Easting, 500_000.0),
            (Role::Northing, if south { 1e7 } else { 0.0 }),
        ];
        Conversion {
            method: &METHODS[0],
            values,
        }
    }

    /// The method and values of a PROJ string, such as [`proj`](Self::proj) writes it.
    pub fn of_proj(definition: &str) -> Option<Conversion> {
        let get = |name: &str| super::parameter(definition, name);
        let number = |name: &str| get(name).and_then(|v| v.parse::<f64>().ok());
        let name = get("proj")?;
        let one_parallel = number("lat_2").is_none() && number("lat_1") == number("lat_0");
        let polar = number("lat_0").is_some_and(|lat| lat.abs() == 90.0);
        let method = METHODS.iter().find(|m| {
            m.proj == name
                && match m.geotiff {
                    TWO_PARALLEL_LAMBERT => !one_parallel,
                    ONE_PARALLEL_LAMBERT => one_parallel,
                    POLAR => polar,
                    FROM_NATURAL_ORIGIN => super::has_flag(definition, "no_uoff"),
                    9815 => !super::has_flag(definition, "no_uoff"),
                    _ => true,
                }
        })?;
        let mut conversion = Self::new(method);
        for (parameter, role, _) in method.parameters {
            let value = number(parameter).or_else(|| match *parameter {
                "k_0" => number("k"),
                _ => None,
            });
            conversion.values.extend(value.map(|value| (*role, value)));
        }
        Some(conversion)
    }

    fn new(method: &'static Method) -> Conversion {
        let values = Vec::new();
        Conversion { method, values }
    }

    /// The value of a role.
    pub fn get(&self, role: Role) -> Option<f64> {
        let found = self.values.iter().find(|(have, _)| *have == role);
        found.map(|(_, value)| *value)
    }

    /// `+proj=... +lat_0=...`, without datum, units and title.
    pub fn proj(&self) -> String {
        let mut out = format!("+proj={}", self.method.proj);
        for (name, role, _) in self.method.parameters {
            if let Some(value) = self.value_for_proj(name, *role) {
                out += &format!(" +{name}={value}");
            }
        }
        match self.method.geotiff {
            // PROJ has one method for both; with one parallel it is that of the origin.
            ONE_PARALLEL_LAMBERT => {
                out += &format!(" +lat_1={}", self.get(Role::Latitude).unwrap_or(0.0));
            }
            FROM_NATURAL_ORIGIN => out += " +no_uoff",
            _ => {}
        }
        out
    }

    /// A polar method's parallel says both from which pole it looks, and where its scale is 1.
    fn value_for_proj(&self, name: &str, role: Role) -> Option<f64> {
        if self.method.geotiff != POLAR {
            return self.get(role);
        }
        let latitude = self.get(Role::Latitude).or(self.get(Role::Parallel1));
        match name {
            "lat_0" => latitude.map(|lat| 90f64.copysign(lat)),
            "lat_ts" => self
                .get(Role::Parallel1)
                .or(latitude)
                .filter(|lat| lat.abs() < 90.0),
            _ => self.get(role),
        }
    }

    /// GeoKeys of the parameters with their values.
    pub fn geokeys(&self) -> Vec<(u16, f64)> {
        let mut keys = Vec::new();
        for (name, role, key) in self.method.parameters {
            // GeoTIFF's polar method has one latitude: that of true scale.
            let value = match (self.method.geotiff, *name) {
                (POLAR, "lat_0") => self.get(Role::Parallel1).or(self.get(*role)),
                _ => self.get(*role),
            };
            keys.extend(value.filter(|_| *key != 0).map(|value| (*key, value)));
        }
        keys
    }
}

/// A name without case, spaces, underscores, hyphens and brackets.
pub(crate) fn plain(name: &str) -> String {
    let letters = name.chars().filter(char::is_ascii_alphanumeric);
    letters.map(|c| c.to_ascii_lowercase()).collect()
}
