//! The values of labels: closed lists, so that nobody can make their number grow.

/// One label as the library takes it.
pub(super) type Reason = [(&'static str, &'static str); 1];

macro_rules! reasons {
    ($(#[$doc:meta])* $name:ident, $key:literal { $($(#[$note:meta])* $variant:ident = $text:literal,)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum $name {
            $($(#[$note])* $variant,)*
        }

        impl $name {
            /// The label with this value.
            pub(super) fn label(self) -> Reason {
                let text = match self {
                    $($name::$variant => $text,)*
                };
                [($key, text)]
            }
        }
    };
}

reasons! {
    /// Why a session did not come about.
    Refusal, "reason" {
        /// All sessions are taken.
        Full = "full",
        /// The server is going down.
        Draining = "draining",
        /// One address has too many.
        Address = "address",
        /// The page that asked comes from an origin that is not allowed.
        Origin = "origin",
        /// The token is missing, or not that of the dataset.
        Denied = "denied",
        /// There is no such dataset.
        NoDataset = "no_dataset",
        /// No common protocol version or codec.
        Version = "version",
    }
}

reasons! {
    /// How an open session ended.
    Ended, "reason" {
        /// The client closed it.
        Client = "client",
        /// The connection was lost.
        Lost = "lost",
        /// The client came to a limit, such as that of silence.
        Limit = "limit",
        /// The client broke the protocol.
        Protocol = "protocol",
        /// The server went down.
        Shutdown = "shutdown",
        /// Something failed here.
        Internal = "internal",
    }
}

reasons! {
    /// What a limit for one address refused.
    Limited, "what" {
        /// A request, with status 429.
        Request = "request",
        /// A connection, which was closed.
        Connection = "connection",
        /// A session, with status 429.
        Session = "session",
    }
}

reasons! {
    /// Why a TLS handshake failed.
    TlsFailure, "reason" {
        /// What came was no TLS, say plain HTTP.
        NotTls = "not_tls",
        /// No common version or cipher suite, a broken message, or a certificate refused.
        Handshake = "handshake",
        /// It took too long.
        Timeout = "timeout",
        /// The connection ended in the middle.
        Closed = "closed",
    }
}
