#include "server/flags.h"

#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <map>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "server/service/listen_address.h"
#include "server/service/log.h"
#include "server/service/security_options.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

constexpr char kFooter[] =
    R"(Every flag can be given by the environment too: --data-dir as DELTARAY_DATA_DIR. The flag comes first.
Sizes take suffixes: 64MB, 4GB (powers of 1024).

Examples:
  deltarayd                                        serve this machine from ./deltaray-data at port 7878
  deltarayd --data-dir /var/lib/deltaray --listen 127.0.0.1:0 --port-file port
  deltarayd --listen 0.0.0.0:7878 --tls-cert server.pem --tls-key server.key --token-file tokens
  DELTARAY_THREADS=8 deltarayd --insecure-listen --listen 0.0.0.0:7878

Exit codes: 0 after one of the signals below; 1 where the server could not start; 2 for a wrong flag; 3 where something hung
until 10 s after the drain.
The first SIGTERM, SIGINT or SIGHUP lets batches under way finish, the second one ends the server at once.)";

// Adds a flag that has an environment variable, and shows its default.
template <typename Value>
CLI::Option* AddFlag(CLI::App& app, const char* group, const std::string& name, Value& value, const char* help) {
  std::string variable = "DELTARAY_" + name;
  for (char& c : variable) c = c == '-' ? '_' : static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  return app.add_option("--" + name, value, help)->envname(variable)->group(group)->capture_default_str();
}

// An integer, as CLI::Range shows in full; it rounds others.
constexpr int64_t kMaxBytes = 1'000'000'000'000'000;

// CLI::Range lets it pass.
std::string NotNan(const std::string& number) {
  return std::isnan(std::strtod(number.c_str(), nullptr)) ? number + " is not a number" : "";
}

void AddServerFlags(CLI::App& app, Flags& flags) {
  ServerOptions& server = flags.server;
  const auto size = CLI::AsSizeValue(false);
  const CLI::Range threads(0, 4096);

  AddFlag(app, "Network", "listen", server.listen, "Address: host:port, or unix:path. Port 0 picks a free one")
      ->check([](const std::string& address) { return std::string(ValidateListenAddress(address).message()); });
  app.add_flag("--insecure-listen", flags.insecure_listen,
               "Listen at an address that other machines can reach, without encryption")
      ->envname("DELTARAY_INSECURE_LISTEN")
      ->group("Security");
  AddFlag(app, "Security", "tls-cert", server.security.tls_cert,
          "Certificate in PEM, then those that lead to its authority: encrypts all connections");
  AddFlag(app, "Security", "tls-key", server.security.tls_key, "Private key of that certificate in PEM");
  AddFlag(app, "Security", "tls-client-ca", server.security.tls_client_ca,
          "Authorities in PEM: lets in only clients that have a certificate of one of them");
  AddFlag(app, "Security", "token-file", server.security.token_file,
          "Lets in only calls with a token of this file; a line: read or write, and the token's SHA-256");
  AddFlag(app, "Network", "port-file", flags.port_file, "File to write the port to once the server listens");
  AddFlag(app, "Network", "drain-timeout", flags.drain_seconds,
          "Seconds that calls under way get to finish after SIGTERM")
      ->check(CLI::Range(0.0, 86400.0))
      ->check(NotNan);

  AddFlag(app, "Metrics", "metrics-listen", server.metrics_listen,
          "Address at which Prometheus fetches /metrics: host:port. Empty: nowhere")
      ->check([](const std::string& address) { return std::string(ValidateMetricsAddress(address).message()); });
  app.add_flag("--insecure-metrics-listen", flags.insecure_metrics_listen,
               "Show metrics at an address that other machines can reach, to whoever asks")
      ->envname("DELTARAY_INSECURE_METRICS_LISTEN")
      ->group("Metrics");

  app.add_flag("--channelz", server.channelz,
               "Tell of connections and calls by gRPC's channelz, to whoever asks, without a token")
      ->envname("DELTARAY_CHANNELZ")
      ->group("Metrics");

  AddFlag(app, "Network", "watchdog-interval", flags.watchdog_seconds,
          "Seconds between two looks of the server at whether it accepts connections and answers")
      ->check(CLI::Range(0.1, 3600.0))
      ->check(NotNan);

  AddFlag(app, "Storage", "data-dir", server.store.data_directory,
          "Directory that meshes are kept in; made if missing");

  AddFlag(app, "Threads", "threads", server.threads, "Threads that trace rays. 0: all cores")->check(threads);
  AddFlag(app, "Threads", "build-threads", server.store.build_threads, "Threads of one build. 0: all cores")
      ->check(threads);
  AddFlag(app, "Threads", "concurrent-builds", server.store.concurrent_builds, "Meshes built at the same time")
      ->check(CLI::Range(1, 1024));
  AddFlag(app, "Threads", "max-queued-builds", server.store.max_queued_builds, "Builds that wait for their turn")
      ->check(CLI::Range(1, 1 << 20));

  AddFlag(app, "Limits", "max-batch-rays", server.batch.max_rays, "Rays of one batch")->check(CLI::Range(1, 1 << 30));
  AddFlag(app, "Limits", "max-message-bytes", server.batch.max_message_bytes, "Bytes of one message, either way")
      ->transform(size)
      ->check(CLI::Range(4 << 20, 1 << 30));
  AddFlag(app, "Limits", "network-bytes", server.network_bytes,
          "Bytes of messages on their way in, over all connections; four messages where that is more")
      ->transform(size)
      ->check(CLI::Range(int64_t{1 << 20}, kMaxBytes));
  AddFlag(app, "Limits", "max-upload-bytes", server.store.max_upload_bytes, "Bytes of one uploaded file")
      ->transform(size)
      ->check(CLI::Range(int64_t{1}, kMaxBytes));
  AddFlag(app, "Limits", "batch-bytes", server.batch_bytes,
          "Bytes of batches being answered and of replies not taken yet, over all clients; four messages where that "
          "is more")
      ->transform(size)
      ->check(CLI::Range(int64_t{1 << 20}, kMaxBytes));
  const CLI::Range count(1, 1 << 20);
  AddFlag(app, "Clients", "max-connections", server.max_connections,
          "Connections at once; fewer where the limit on open files is low")
      ->check(count);
  AddFlag(app, "Clients", "max-connection-calls", server.max_connection_calls, "Calls at once on one connection")
      ->check(count);
  AddFlag(app, "Clients", "max-calls", server.calls.calls, "Calls at once, of all kinds")->check(count);
  AddFlag(app, "Clients", "max-streams", server.calls.streams, "Streams of rays at once")->check(count);
  AddFlag(app, "Clients", "max-uploads", server.calls.uploads, "Uploads at once")->check(count);
  AddFlag(app, "Clients", "max-metadata-bytes", server.max_metadata_bytes, "Bytes of the metadata of one call")
      ->transform(size)
      ->check(CLI::Range(1 << 10, 1 << 20));
  AddFlag(app, "Clients", "idle-timeout", flags.idle_seconds,
          "Seconds that a stream, an upload, or a connection without calls may do nothing")
      ->check(CLI::Range(1.0, 86400.0))
      ->check(NotNan);

  AddFlag(app, "Log", "log-level", flags.log_level, "What to log on stderr")
      ->check(CLI::IsMember({"trace", "debug", "info", "warning", "error", "off"}));
  AddFlag(app, "Log", "log-format", flags.log_format, "Lines for people, or an object of JSON a line")
      ->check(CLI::IsMember({"text", "json"}));
}

// Limits on what one file holds.
void AddMeshLimits(CLI::App& app, MeshLimits& limits) {
  const auto size = CLI::AsSizeValue(false);
  const CLI::Range count(1, 2147483647);
  AddFlag(app, "Limits", "max-triangles", limits.max_triangles, "Triangles of one mesh")->check(count);
  AddFlag(app, "Limits", "max-vertices", limits.max_vertices, "Vertices of one mesh")->check(count);
  AddFlag(app, "Limits", "max-face-corners", limits.max_face_corners, "Corners of one polygon")
      ->check(CLI::Range(3, 1 << 20));
  AddFlag(app, "Limits", "max-line-bytes", limits.max_line_bytes, "Bytes of a line of a text format")
      ->transform(size)
      ->check(CLI::Range(1 << 10, 1 << 26));
  AddFlag(app, "Limits", "max-groups", limits.max_groups, "Groups of one mesh")->check(CLI::Range(1, 1 << 20));
  AddFlag(app, "Limits", "max-group-name-bytes", limits.max_group_name_bytes, "Bytes of the name of one group")
      ->transform(size)
      ->check(CLI::Range(1, 1 << 16));
  AddFlag(app, "Limits", "max-group-bytes", limits.max_group_bytes,
          "Bytes of the names of all groups of one mesh; at most a quarter of a message")
      ->transform(size)
      ->check(CLI::Range(1, 1 << 28));
}

// Limits of the store as a whole.
void AddStoreLimits(CLI::App& app, MeshStore::Options& store) {
  const auto size = CLI::AsSizeValue(false);
  AddFlag(app, "Limits", "tree-bytes", store.tree_bytes,
          "Bytes of memory of meshes and trees, those being built or uploaded included. Trees that were not used for "
          "longest make room, and are built again when asked for")
      ->transform(size)
      ->check(CLI::Range(int64_t{1 << 20}, kMaxBytes));
  AddFlag(app, "Limits", "max-stored-bytes", store.max_stored_bytes, "Bytes of all meshes and uploads on disk")
      ->transform(size)
      ->check(CLI::Range(int64_t{1}, 1000 * kMaxBytes));
  AddFlag(app, "Limits", "max-meshes", store.max_meshes, "Meshes")->check(CLI::Range(1, 1'000'000'000));
  AddFlag(app, "Limits", "max-names", store.max_names, "Names of all meshes")->check(CLI::Range(1, 1'000'000'000));
  AddFlag(app, "Limits", "max-names-per-mesh", store.max_names_per_mesh, "Names of one mesh")
      ->check(CLI::Range(1, 1'000'000));
}

// An empty value, where a variable was meant to hold the path, would leave the server open or without its meshes.
absl::Status CheckPaths(const CLI::App& app) {
  for (const char* name : {"--data-dir", "--tls-cert", "--tls-key", "--tls-client-ca", "--token-file"}) {
    const CLI::Option* const option = app.get_option(name);
    const char* const variable = std::getenv(option->get_envname().c_str());
    const bool empty_flag = option->count() > 0 && option->as<std::string>().empty();
    const bool empty_variable = option->count() == 0 && variable != nullptr && *variable == '\0';
    if (empty_flag || empty_variable) return absl::InvalidArgumentError(absl::StrCat(name, ": is given, but empty"));
  }
  return absl::OkStatus();
}

std::chrono::milliseconds Milliseconds(double seconds) {
  return std::chrono::milliseconds(static_cast<int64_t>(seconds * 1000));
}

}  // namespace

void AddFlags(CLI::App& app, Flags& flags) {
  app.footer(kFooter);
  app.set_version_flag("--version", std::string("deltarayd ") + DELTARAY_VERSION);
  AddServerFlags(app, flags);
  AddMeshLimits(app, flags.server.store.mesh_limits);
  AddStoreLimits(app, flags.server.store);
}

absl::Status FinishFlags(const CLI::App& app, Flags& flags) {
  ServerOptions& server = flags.server;
  if (absl::Status status = CheckPaths(app); !status.ok()) return status;
  if (absl::Status status = ValidateSecurity(server.security, server.listen, flags.insecure_listen); !status.ok()) {
    return status;
  }
  if (!flags.insecure_metrics_listen && !server.metrics_listen.empty() && !IsLoopback(server.metrics_listen)) {
    return absl::InvalidArgumentError(
        absl::StrCat("--metrics-listen: other machines can reach ", server.metrics_listen,
                     ", and metrics are shown to whoever asks; say --insecure-metrics-listen if that is meant"));
  }
  server.drain_timeout = Milliseconds(flags.drain_seconds);
  server.watchdog_interval = Milliseconds(flags.watchdog_seconds);
  server.idle_timeout = Milliseconds(flags.idle_seconds);
  return absl::OkStatus();
}

void LogFlags(const CLI::App& app, const ServerOptions& server) {
  // What one message bounds is told as it is in force.
  const std::map<std::string, uint64_t> in_force{{"network-bytes", server.network_bytes_in_force()},
                                                 {"batch-bytes", server.batch_bytes_in_force()},
                                                 {"max-group-bytes", server.max_group_bytes_in_force()}};
  std::vector<std::pair<std::string, std::string>> values{{"version", DELTARAY_VERSION}};
  for (const CLI::Option* option : app.get_options()) {
    if (option->get_envname().empty()) continue;  // --help, --version
    const std::string& name = option->get_lnames().at(0);
    const std::string unset = option->get_items_expected_max() == 0 ? "false" : option->get_default_str();
    std::string value = option->count() == 0 ? unset : absl::StrJoin(option->results(), ",");
    if (const auto found = in_force.find(name); found != in_force.end()) value = absl::StrCat(found->second);
    values.emplace_back(name, std::move(value));
  }
  LogFields fields;
  for (const auto& [name, value] : values) fields.emplace_back(name, value);
  LogEvent(spdlog::level::info, "deltarayd starts", fields);
  if (server.network_bytes_in_force() != server.network_bytes || server.batch_bytes_in_force() != server.batch_bytes) {
    spdlog::warn("--network-bytes and --batch-bytes are four times --max-message-bytes, {}, at least",
                 4 * server.batch.max_message_bytes);
  }
}

}  // namespace deltaray
