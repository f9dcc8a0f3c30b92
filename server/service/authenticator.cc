#include "server/service/authenticator.h"

#include <algorithm>
#include <array>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

constexpr absl::string_view kScheme = "bearer ";

// All others change what is stored or built, and a method that is new here is one of them until it is listed.
constexpr std::array<std::string_view, 9> kReadMethods = {
    "MeshService/GetMesh",        "MeshService/ListMeshes", "MeshService/WatchBuild",
    "MeshService/GetBuildStats",  "RayService/CastRays",    "RayService/StreamRays",
    "RayService/CompareAccuracy", "Health/Check",           "Health/Watch"};

// The token of a call, empty where it has none. With two of them it would depend on the order which one counts.
absl::StatusOr<absl::string_view> TokenOf(const grpc::CallbackServerContext& context) {
  const auto [first, last] = context.client_metadata().equal_range("authorization");
  if (first == last) {
    return absl::UnauthenticatedError(
        "this server answers calls that carry a token only: metadata 'authorization: Bearer TOKEN'");
  }
  const absl::string_view value(first->second.data(), first->second.size());
  if (std::next(first) != last || !absl::StartsWithIgnoreCase(value, kScheme) || value.size() == kScheme.size()) {
    return absl::UnauthenticatedError("the metadata 'authorization' must be there once and of the form 'Bearer TOKEN'");
  }
  return value.substr(kScheme.size());
}

}  // namespace

absl::StatusOr<std::unique_ptr<Authenticator>> Authenticator::Start(const std::string& token_file) {
  std::unique_ptr<Authenticator> authenticator(new Authenticator);
  absl::StatusOr<std::unique_ptr<ReloadedFiles>> file = ReloadedFiles::Start(
      {{"token-file", token_file, {}}}, [self = authenticator.get()](const std::vector<ReloadedFile>& files) {
        absl::StatusOr<TokenTable> tokens = TokenTable::Parse(files[0].bytes);
        if (!tokens.ok()) return files[0].Error(tokens.status().message());
        spdlog::info("{} tokens are let in by {}", tokens->size(), files[0].path);
        auto table = std::make_shared<const TokenTable>(*std::move(tokens));
        MutexLock lock(self->mutex_);
        self->tokens_ = std::move(table);
        return absl::OkStatus();
      });
  if (!file.ok()) return file.status();
  authenticator->file_ = *std::move(file);
  return authenticator;
}

absl::Status Authenticator::OnBegin(RpcInfo& rpc) {
  const absl::StatusOr<absl::string_view> token = TokenOf(*rpc.context);
  if (!token.ok()) return token.status();
  std::shared_ptr<const TokenTable> tokens;
  {
    MutexLock lock(mutex_);
    tokens = tokens_;
  }
  const std::optional<Role> role = tokens->Find(*token);
  if (!role.has_value()) return absl::UnauthenticatedError("the token is not one that this server knows");
  const bool reads = std::ranges::find(kReadMethods, rpc.method) != kReadMethods.end();
  if (reads || *role == Role::kWrite) return absl::OkStatus();
  return absl::PermissionDeniedError(
      absl::StrCat(std::string(rpc.method), " needs a token of the role 'write'; this one has the role 'read'"));
}

}  // namespace deltaray
